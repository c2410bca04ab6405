"""Reads and writes the file in the dataset directory with the endpoints of its running coordinator.

The file is a hint: a killed coordinator leaves it behind, so the lock of the directory decides whether one runs.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from schemas.errors import RunFinished, WorldError
from schemas.protocol.reachability import split_endpoint

ADDRESS_FILE = ".coordinator.json"
_WILDCARDS = {"0.0.0.0", "::"}  # noqa: S104 - compared, not listened on


class CoordinatorAddress(NamedTuple):
    """Contents of the address file."""

    run: str
    """Name of the run."""
    endpoints: tuple[str, ...]
    """Endpoints of the coordinator; none if the run is finished and its coordinator has ended."""
    pid: int
    """Process id of the coordinator."""


def write_address(root: Path, run: str, endpoints: Sequence[str]) -> None:
    text = json.dumps({"run": run, "endpoints": list(endpoints), "pid": os.getpid()})
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
        return CoordinatorAddress(str(content["run"]), tuple(map(str, content["endpoints"])), int(content["pid"]))
    except (OSError, ValueError, KeyError, TypeError):
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
        endpoints += address.endpoints
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
