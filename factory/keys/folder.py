"""The folder of an authority: its own files, one folder a host, and the list of those admitted. Signs nothing itself.

`DIR/ca.pem`, `DIR/ca.key`, `DIR/hosts.txt`, and `DIR/<host>/` to be copied whole to that host. Secrets are 0600.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from factory.keys.authority import Certificate, expiry_of, found_authority, issue
from schemas.errors import UsageError
from schemas.identity import ADMITTED_FILE, CA_FILE, Role, parse_admitted, require_host_name, spell_admitted, tls_files
from schemas.storage.disk import translated

__all__ = ["HostKeys", "admit", "found", "list_hosts", "revoke"]

_CA_KEY_FILE, _ROLE_FILE = "ca.key", "role.txt"


class HostKeys(NamedTuple):
    """One host that has a certificate."""

    name: str
    role: Role
    admitted: bool
    expires: datetime
    folder: Path


def found(folder: Path, name: str, days: int, now: datetime) -> Path:
    """Makes an authority in a folder that has none.

    Raises:
        UsageError: there is one; replacing it would shut every host out.
    """
    if (folder / _CA_KEY_FILE).exists() or (folder / CA_FILE).exists():
        raise UsageError(
            f"{folder} contains an authority already; a new one would lock out all its hosts: choose another folder"
        )
    made = found_authority(name, days, now)
    with translated("write", folder):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        _write_secret(folder / _CA_KEY_FILE, made.key)
        _write_open(folder / CA_FILE, made.certificate)
        _write_open(folder / ADMITTED_FILE, spell_admitted({}).encode())
    return folder


def admit(
    folder: Path, name: str, role: Role, addresses: Sequence[str], days: int, now: datetime, *, renew: bool = False
) -> Path:
    """Makes the folder of a host, with a certificate of its own, and admits it.

    Args:
        folder: of the authority.
        name: of the host; becomes the common name.
        role: what the certificate is for.
        addresses: under which a coordinator or gateway is reached, besides its name and loopback.
        days: of validity.
        now: the beginning.
        renew: whether a certificate that is there is replaced.

    Returns:
        The folder to copy to that host and to give as `--tls`.

    Raises:
        UsageError: no authority, no name for a host, or the host has a certificate.
    """
    authority = _authority(folder)
    place = folder / require_host_name(name)
    files = tls_files(place)
    if files.key.exists() and not renew:
        raise UsageError(f"{place} has a certificate already: give --renew to replace it, or choose another name")
    made = issue(authority, name, role, addresses, days, now)
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
    _tell_listeners(folder, admitted)
    return place


def revoke(folder: Path, name: str) -> tuple[Path, ...]:
    """Takes a host from the lists of those admitted; its certificate is of no use from then on.

    Returns:
        The lists that coordinators and gateways read; those on other machines have to be copied there.

    Raises:
        UsageError: it is not admitted.
    """
    _authority(folder)
    admitted = dict(_admitted(folder))
    if admitted.pop(name, None) is None:
        known = ", ".join(admitted) or "none"
        raise UsageError(f"{name!r} is not admitted; admitted hosts: {known}")
    return _tell_listeners(folder, admitted)


def list_hosts(folder: Path) -> list[HostKeys]:
    """Returns every host that has a certificate, by name.

    Raises:
        UsageError: there is no authority.
    """
    _authority(folder)
    admitted = _admitted(folder)
    hosts = []
    for place in sorted(path.parent for path in folder.glob(f"*/{_ROLE_FILE}")):
        role = Role((place / _ROLE_FILE).read_text().strip())
        is_in = role is Role.COORDINATOR or admitted.get(place.name) is role
        hosts.append(HostKeys(place.name, role, is_in, expiry_of(tls_files(place).certificate.read_bytes()), place))
    return hosts


def _authority(folder: Path) -> Certificate:
    try:
        return Certificate((folder / CA_FILE).read_bytes(), (folder / _CA_KEY_FILE).read_bytes())
    except OSError as error:
        raise UsageError(
            f"{folder} does not contain an authority ({error.strerror}): create one with `factory keys ca {folder}`"
        ) from error


def _admitted(folder: Path) -> Mapping[str, Role]:
    path = folder / ADMITTED_FILE
    return parse_admitted(path.read_text(encoding="ascii")) if path.exists() else {}


def _tell_listeners(folder: Path, admitted: Mapping[str, Role]) -> tuple[Path, ...]:
    roles = {path.parent: path.read_text().strip() for path in folder.glob(f"*/{_ROLE_FILE}")}
    coordinators = {place.name: Role.COORDINATOR for place, role in roles.items() if role == Role.COORDINATOR}
    told = {folder: admitted}
    told |= {place: admitted for place, role in roles.items() if role == Role.COORDINATOR}
    told |= {place: {**admitted, **coordinators} for place, role in roles.items() if role == Role.GATEWAY}
    with translated("write", folder):
        for place, names in told.items():
            _write_open(place / ADMITTED_FILE, spell_admitted(names).encode())
    return tuple(sorted(place / ADMITTED_FILE for place in told.keys() - {folder}))


def _write_secret(path: Path, data: bytes) -> None:
    _write(path, data, 0o600)


def _write_open(path: Path, data: bytes) -> None:
    _write(path, data, 0o644)


def _write(path: Path, data: bytes, mode: int) -> None:
    """Replaces a file as a whole, so that nobody reads half of it."""
    part = path.with_name(f".{path.name}.part")
    part.unlink(missing_ok=True)
    descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
    with os.fdopen(descriptor, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)
