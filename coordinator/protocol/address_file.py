"""A file in the dataset directory that says where its running coordinator can be asked; gone when none runs.

A hint only: a killed coordinator leaves it behind, and the directory's lock has the last word.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

__all__ = ["ADDRESS_FILE", "CoordinatorAddress", "read_address", "remove_address", "write_address"]

ADDRESS_FILE = ".coordinator.json"


class CoordinatorAddress(NamedTuple):
    """What the file says."""

    run: str
    endpoints: tuple[str, ...]
    pid: int


def write_address(root: Path, run: str, endpoints: Sequence[str]) -> None:
    """Writes the file."""
    text = json.dumps({"run": run, "endpoints": list(endpoints), "pid": os.getpid()})
    part = root / f"{ADDRESS_FILE}.part"
    part.write_text(text, encoding="utf-8")
    part.replace(root / ADDRESS_FILE)


def remove_address(root: Path) -> None:
    """Removes the file."""
    (root / ADDRESS_FILE).unlink(missing_ok=True)


def read_address(root: Path) -> CoordinatorAddress | None:
    """Reads the file; `None` when there is none that can be understood."""
    try:
        found = json.loads((root / ADDRESS_FILE).read_text(encoding="utf-8"))
        return CoordinatorAddress(str(found["run"]), tuple(map(str, found["endpoints"])), int(found["pid"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None
