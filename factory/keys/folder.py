"""Manages the folder of a certificate authority: its files, one folder for each host, and the list of admitted hosts.

The layout is `DIR/ca.pem`, `DIR/ca.key`, `DIR/hosts.txt` and `DIR/<host>/`; the user copies `DIR/<host>/` to that host.
Private keys have mode 0600. Signs nothing itself.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from factory.keys.authority import Certificate, create_authority_certificate, expiry_of, issue
from schemas.errors import UsageError
from schemas.protocol.identity import (
    ADMITTED_FILE,
    CA_FILE,
    Role,
    format_admitted,
    parse_admitted,
    require_host_name,
    tls_files,
)
from schemas.storage.disk import translated
from schemas.support.shell import quoted

_CA_KEY_FILE, _ROLE_FILE = "ca.key", "role.txt"


class HostKeys(NamedTuple):
    """Host with a certificate."""

    name: str
    role: Role
    admitted: bool
    expires: datetime
    folder: Path


def create_authority(folder: Path, name: str, days: int, now: datetime) -> Path:
    """Creates a certificate authority in a folder that has none.

    Raises:
        UsageError: The folder already has an authority; replacing it would invalidate every host certificate.
    """
    if (folder / _CA_KEY_FILE).exists() or (folder / CA_FILE).exists():
        raise UsageError(
            f"{folder} contains an authority already; a new one would lock out all its hosts: choose another folder"
        )
    made = create_authority_certificate(name, days, now)
    with translated("write", folder):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        _write_secret(folder / _CA_KEY_FILE, made.key)
        _write_open(folder / CA_FILE, made.certificate)
        _write_open(folder / ADMITTED_FILE, format_admitted({}).encode())
    return folder


def admit(
    folder: Path, name: str, role: Role, addresses: Sequence[str], days: int, now: datetime, *, renew: bool = False
) -> Path:
    """Creates the folder of a host with its certificate, and adds the host to the admission lists.

    Args:
        folder: Folder of the authority.
        name: Name of the host, used as the common name.
        role: Role of the host.
        addresses: Addresses of a coordinator or gateway in addition to its name and loopback.
        days: Validity, days.
        now: Current time, the start of validity.
        renew: Whether to replace an existing certificate.

    Returns:
        The folder to copy to the host and to pass as `--tls`.

    Raises:
        UsageError: The folder has no authority, the name is invalid, or the host already has a certificate.
    """
    authority = _authority(folder)
    place = folder / require_host_name(name)
    files = tls_files(place)
    if files.key.exists() and not renew:
        raise UsageError(f"{place} already has a certificate; pass --renew to replace it, or choose another name")
    made = issue(authority, name, role=role, addresses=addresses, days=days, now=now)
    with translated("write", place):
        place.mkdir(mode=0o700, exist_ok=True)
        _write_secret(files.key, made.key)
        _write_open(files.certificate, made.certificate)
        _write_open(files.ca, authority.certificate)
        _write_open(files.name, f"{name}\n".encode())
        _write_open(place / _ROLE_FILE, f"{role}\n".encode())
    admitted = dict(_admitted(folder))
    admitted.pop(name, None)
    if role is not Role.COORDINATOR:
        admitted[name] = role
    _write_admission_lists(folder, admitted)
    return place


def revoke(folder: Path, name: str) -> tuple[Path, ...]:
    """Removes a host from the admission lists; coordinators and gateways reject its certificate from then on.

    Returns:
        The paths of the admission lists of coordinators and gateways. Copy them to those machines.

    Raises:
        UsageError: The host is not admitted.
    """
    _authority(folder)
    admitted = dict(_admitted(folder))
    if admitted.pop(name, None) is None:
        known = ", ".join(admitted) or "none"
        raise UsageError(f"{name!r} is not admitted; admitted hosts: {known}")
    return _write_admission_lists(folder, admitted)


def list_hosts(folder: Path) -> list[HostKeys]:
    """Returns all hosts with a certificate, sorted by name.

    Raises:
        UsageError: The folder has no authority.
    """
    _authority(folder)
    admitted = _admitted(folder)
    hosts = []
    for place in sorted(path.parent for path in folder.glob(f"*/{_ROLE_FILE}")):
        role = Role((place / _ROLE_FILE).read_text().strip())
        is_in = role is Role.COORDINATOR or admitted.get(place.name) is role
        hosts.append(
            HostKeys(
                place.name,
                role,
                admitted=is_in,
                expires=expiry_of(tls_files(place).certificate.read_bytes()),
                folder=place,
            )
        )
    return hosts


def _authority(folder: Path) -> Certificate:
    try:
        return Certificate((folder / CA_FILE).read_bytes(), (folder / _CA_KEY_FILE).read_bytes())
    except OSError as error:
        raise UsageError(
            f"{folder} does not contain an authority ({error.strerror}): create one with `factory keys ca "
            f"{quoted(folder)}`"
        ) from error


def _admitted(folder: Path) -> Mapping[str, Role]:
    path = folder / ADMITTED_FILE
    return parse_admitted(path.read_text(encoding="ascii")) if path.exists() else {}


def _write_admission_lists(folder: Path, admitted: Mapping[str, Role]) -> tuple[Path, ...]:
    roles = {path.parent: path.read_text().strip() for path in folder.glob(f"*/{_ROLE_FILE}")}
    coordinators = {place.name: Role.COORDINATOR for place, role in roles.items() if role == Role.COORDINATOR}
    lists = {folder: admitted}
    lists |= {place: admitted for place, role in roles.items() if role == Role.COORDINATOR}
    lists |= {place: {**admitted, **coordinators} for place, role in roles.items() if role == Role.GATEWAY}
    with translated("write", folder):
        for place, names in lists.items():
            _write_open(place / ADMITTED_FILE, format_admitted(names).encode())
    return tuple(sorted(place / ADMITTED_FILE for place in lists.keys() - {folder}))


def _write_secret(path: Path, data: bytes) -> None:
    _write(path, data, 0o600)


def _write_open(path: Path, data: bytes) -> None:
    _write(path, data, 0o644)


def _write(path: Path, data: bytes, mode: int) -> None:
    """Replaces a file atomically."""
    part = path.with_name(f".{path.name}.part")
    part.unlink(missing_ok=True)
    descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
    with os.fdopen(descriptor, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)
