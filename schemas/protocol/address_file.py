"""Reads and writes the file in the dataset directory with the endpoints of its running coordinator.

The file is a hint: a killed coordinator leaves it behind, so the lock of the directory decides whether one runs.
"""

from __future__ import annotations

import ipaddress
import json
import os
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from schemas.errors import RunFinished, WorldError
from schemas.protocol.reachability import split_endpoint

ADDRESS_FILE = ".coordinator.json"
_LOOPBACK_OF = {"0.0.0.0": "127.0.0.1", "::": "::1"}  # noqa: S104 - compared, not listened on
_WILDCARDS = frozenset(_LOOPBACK_OF)


class CoordinatorAddress(NamedTuple):
    """Contents of the address file."""

    run: str
    """Name of the run."""
    endpoints: tuple[str, ...]
    """Endpoints of the coordinator; none if the run is finished and its coordinator has ended."""
    pid: int
    """Process id of the coordinator."""
    bound: tuple[str, ...] = ()
    """Endpoints that the coordinator listens on, with wildcard addresses; none in files of older versions."""
    host: str = ""
    """Name of the machine of the coordinator."""

    @property
    def nearest(self) -> tuple[str, ...]:
        """Endpoints to connect to from this machine: those of loopback if the coordinator runs here and listens there,
        else the bound addresses before the names, which may not be resolved here."""
        if self.host != socket.gethostname():
            return self.endpoints
        local = loopback_endpoints(self.bound)
        return local or tuple(dict.fromkeys((*self.bound, *self.endpoints)))


def loopback_endpoints(bound: Sequence[str]) -> tuple[str, ...]:
    """Returns the loopback endpoints among bound ones; a wildcard address includes loopback."""
    places = [(protocol, _LOOPBACK_OF.get(host, host), port) for protocol, host, port in map(split_endpoint, bound)]
    return tuple(f"{protocol}/{_bracketed(host)}:{port}" for protocol, host, port in places if is_loopback_name(host))


def is_loopback_name(host: str) -> bool:
    """Returns whether a host is `localhost` or an address of loopback."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def write_address(root: Path, run: str, endpoints: Sequence[str], bound: Sequence[str] = ()) -> None:
    """Writes the address file.

    Args:
        root: directory of the run.
        run: name of the run.
        endpoints: endpoints for other machines; none if the run is finished.
        bound: endpoints that the coordinator listens on.
    """
    address = {"run": run, "endpoints": list(endpoints), "pid": os.getpid()}
    text = json.dumps({**address, "bound": list(bound), "host": socket.gethostname()})
    part = root / f"{ADDRESS_FILE}.part"
    part.write_text(text, encoding="utf-8")
    part.replace(root / ADDRESS_FILE)


def mark_finished(root: Path, run: str) -> None:
    """Writes that the run is finished, so workers that start later end instead of waiting for a coordinator."""
    write_address(root, run, ())


def remove_address(root: Path) -> None:
    (root / ADDRESS_FILE).unlink(missing_ok=True)


def read_address(root: Path, name: str = ADDRESS_FILE) -> CoordinatorAddress | None:
    """Reads the address file; returns `None` if it does not exist or is invalid."""
    try:
        content = json.loads((root / name).read_text(encoding="utf-8"))
        endpoints, bound = (tuple(map(str, content.get(name, ()))) for name in ("endpoints", "bound"))
        for endpoint in bound:
            split_endpoint(endpoint)
        return CoordinatorAddress(str(content["run"]), endpoints, int(content["pid"]), bound, str(content.get("host")))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def find_endpoints(connect: Sequence[str]) -> tuple[str, ...]:
    """Returns the endpoints of `--connect`; `@FILE` is replaced with the endpoints in an address file.

    Args:
        connect: endpoints, or `@FILE` with an address file or the directory of a run.

    Raises:
        RunFinished: the run of the file is finished, and no coordinator runs.
        WorldError: the file does not exist yet, or is not an address file.
    """
    endpoints: list[str] = []
    for one in connect:
        if not one.startswith("@"):
            endpoints.append(one)
            continue
        path = Path(one[1:])
        address = read_address(path if path.is_dir() else path.parent, path.name if not path.is_dir() else ADDRESS_FILE)
        if address is None:
            raise WorldError(f"{path} has no address of a coordinator: start one with --out in that directory")
        if not address.endpoints:
            raise RunFinished(f"run {address.run} in {path} is finished, and its coordinator has ended")
        endpoints += address.nearest
    return tuple(endpoints)


def usable_endpoints(endpoints: Sequence[str], hosts: Sequence[str]) -> tuple[str, ...]:
    """Returns the endpoints that other hosts connect to: wildcard addresses are replaced with names of this host.

    Args:
        endpoints: endpoints that a coordinator listens on.
        hosts: names or addresses of this host; at least one.
    """
    return tuple(
        f"{protocol}/{name}:{port}"
        for protocol, host, port in map(split_endpoint, endpoints)
        for name in (map(_bracketed, hosts) if host in _WILDCARDS else (_bracketed(host),))
    )


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host
