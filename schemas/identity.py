"""Who may speak: roles and names of hosts, the files of a TLS folder, the list of those admitted. Touches no path."""

from __future__ import annotations

import re
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

from schemas.errors import UsageError
from schemas.wire import HOST_PATTERN

__all__ = [
    "ADMITTED_FILE",
    "CA_FILE",
    "CERTIFICATE_FILE",
    "KEY_FILE",
    "NAME_FILE",
    "Role",
    "TlsFiles",
    "is_host_name",
    "parse_admitted",
    "require_host_name",
    "spell_admitted",
    "tls_files",
]

CA_FILE, CERTIFICATE_FILE, KEY_FILE, NAME_FILE = "ca.pem", "host.pem", "host.key", "name.txt"
ADMITTED_FILE = "hosts.txt"
"""Beside a coordinator's certificate: whom it lets in."""
_HOST_NAME = re.compile(HOST_PATTERN)


class Role(StrEnum):
    """What a certificate is for."""

    WORKER = "worker"  # claims jobs under its own name and serves its own spool
    OPERATOR = "operator"  # asks for progress, retries and cancels
    GATEWAY = "gateway"  # listens to workers, vouches for them to its coordinator, and archives what they bring
    EVALUATOR = "evaluator"  # borrows a coordinator's workers for evaluations, and listens to nobody itself
    COORDINATOR = "coordinator"  # listens; nobody else may pass for it


class TlsFiles(NamedTuple):
    """Where one side's TLS files lie."""

    ca: Path
    """Certificate of the authority that both sides trust."""
    certificate: Path
    key: Path
    name: Path
    """One line: the common name in the certificate."""
    admitted: Path
    """Of a coordinator or gateway only."""


def tls_files(folder: Path) -> TlsFiles:
    """Returns where the files of a TLS folder lie, as `factory keys host` makes it."""
    names = (CA_FILE, CERTIFICATE_FILE, KEY_FILE, NAME_FILE, ADMITTED_FILE)
    return TlsFiles(*(folder / name for name in names))


def is_host_name(name: str) -> bool:
    """Whether a host may be called so: a dot would let one host's sessions look like another's."""
    return _HOST_NAME.fullmatch(name) is not None


def require_host_name(name: str) -> str:
    """Returns the name.

    Raises:
        UsageError: no host can be called so.
    """
    if not is_host_name(name):
        raise UsageError(
            f"{name!r} is not a valid host name: use at most 48 lower-case letters, digits and dashes, e.g. node-07"
        )
    return name


def parse_admitted(text: str, *, of_gateway: bool = False) -> Mapping[str, Role]:
    """Reads `hosts.txt`: one `NAME ROLE` a line, the role `worker` when left out; `#` begins a remark.

    Args:
        text: of the file.
        of_gateway: whether coordinators may be named: a gateway must know whom to believe, nobody else believes any.

    Raises:
        UsageError: a line cannot be understood.
    """
    known = [role for role in Role if of_gateway or role is not Role.COORDINATOR]
    found: dict[str, Role] = {}
    for number, line in enumerate(text.splitlines(), 1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        name, role = (*words, Role.WORKER)[:2]
        if len(words) > 2 or role not in known or not is_host_name(name):
            raise UsageError(f"line {number} is {line[:80]!r}, expected NAME, or NAME and one of: {', '.join(known)}")
        found[name] = Role(role)
    return found


def spell_admitted(admitted: Mapping[str, Role]) -> str:
    """Writes `hosts.txt`."""
    lines = [f"{name} {role}" for name, role in sorted(admitted.items())]
    return "\n".join(["# Who may connect; a host whose line is removed is out within seconds.", *lines, ""])
