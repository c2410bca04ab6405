"""Identity of hosts: roles, host names, the files of a TLS folder, and the list of admitted hosts. Opens no file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

from schemas.errors import UsageError

CA_FILE, CERTIFICATE_FILE, KEY_FILE, NAME_FILE = "ca.pem", "host.pem", "host.key", "name.txt"
ADMITTED_FILE = "hosts.txt"
"""File beside a coordinator's certificate that lists the admitted hosts."""
HOST_PATTERN = r"^[a-z0-9](?:[a-z0-9-]{0,46}[a-z0-9])?$"
_HOST_NAME = re.compile(HOST_PATTERN)


class Role(StrEnum):
    """Role that a certificate grants to a host."""

    WORKER = "worker"  # claims jobs under its own name and serves its own spool
    OPERATOR = "operator"  # requests progress, retries and cancellations
    GATEWAY = "gateway"  # accepts workers, authenticates them to its coordinator, and archives their bundles
    # not an operator, which may cancel jobs, and not a gateway, which may archive: an evaluation needs neither
    EVALUATOR = "evaluator"  # uses a coordinator's workers for evaluations, and accepts no connections
    COORDINATOR = "coordinator"  # accepts connections; no other role may act as coordinator


class TlsFiles(NamedTuple):
    """Paths of the TLS files of one host."""

    ca: Path
    """Certificate of the authority that both sides trust."""
    certificate: Path
    """Certificate of this host."""
    key: Path
    """Private key of this host."""
    name: Path
    """File with one line, the common name in the certificate."""
    admitted: Path
    """List of admitted hosts; only coordinators and gateways have one."""


def tls_files(folder: Path) -> TlsFiles:
    """Returns the paths of the files in a TLS folder that `factory keys host` created."""
    names = (CA_FILE, CERTIFICATE_FILE, KEY_FILE, NAME_FILE, ADMITTED_FILE)
    return TlsFiles(*(folder / name for name in names))


def is_host_name(name: str) -> bool:
    """Returns whether a host name is valid; it has no dot, because a dot separates host and session in a session id."""
    return _HOST_NAME.fullmatch(name) is not None


def require_host_name(name: str) -> str:
    """Returns the name if it is a valid host name.

    Raises:
        UsageError: the name is not valid.
    """
    if not is_host_name(name):
        raise UsageError(
            f"{name!r} is not a valid host name: use at most 48 lower-case letters, digits and dashes, e.g. node-07"
        )
    return name


def parse_admitted(text: str, *, of_gateway: bool = False) -> Mapping[str, Role]:
    """Parses `hosts.txt`: one `NAME ROLE` per line; the default role is `worker`, and `#` starts a comment.

    Args:
        text: content of the file.
        of_gateway: whether the file belongs to a gateway; only a gateway admits coordinators.

    Raises:
        UsageError: a line is not valid.
    """
    known = [role for role in Role if of_gateway or role is not Role.COORDINATOR]
    roles: dict[str, Role] = {}
    for number, line in enumerate(text.splitlines(), 1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        name, role = (*words, Role.WORKER)[:2]
        if len(words) > 2 or role not in known or not is_host_name(name):
            raise UsageError(f"line {number} is {line[:80]!r}, expected NAME, or NAME and one of: {', '.join(known)}")
        roles[name] = Role(role)
    return roles


def format_admitted(admitted: Mapping[str, Role]) -> str:
    """Returns the content of `hosts.txt` for the admitted hosts."""
    lines = [f"{name} {role}" for name, role in sorted(admitted.items())]
    return "\n".join(
        ["# Hosts that may connect. A host whose line is removed is disconnected within seconds.", *lines, ""]
    )
