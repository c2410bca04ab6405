"""Reads and writes the file in the dataset directory with the endpoints of its running coordinator.

The file is a hint: a killed coordinator leaves it behind, so the lock of the directory decides whether one runs.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

ADDRESS_FILE = ".coordinator.json"


class CoordinatorAddress(NamedTuple):
    """Contents of the address file."""

    run: str
    """Name of the run."""
    endpoints: tuple[str, ...]
    """Endpoints of the coordinator."""
    pid: int
    """Process id of the coordinator."""


def write_address(root: Path, run: str, endpoints: Sequence[str]) -> None:
    """Writes the address file of this process."""
    text = json.dumps({"run": run, "endpoints": list(endpoints), "pid": os.getpid()})
    part = root / f"{ADDRESS_FILE}.part"
    part.write_text(text, encoding="utf-8")
    part.replace(root / ADDRESS_FILE)


def remove_address(root: Path) -> None:
    """Removes the address file."""
    (root / ADDRESS_FILE).unlink(missing_ok=True)


def read_address(root: Path) -> CoordinatorAddress | None:
    """Reads the address file; returns `None` if it does not exist or is invalid."""
    try:
        found = json.loads((root / ADDRESS_FILE).read_text(encoding="utf-8"))
        return CoordinatorAddress(str(found["run"]), tuple(map(str, found["endpoints"])), int(found["pid"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None
