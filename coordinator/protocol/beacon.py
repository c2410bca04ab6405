"""A file in the dataset directory that says where its running coordinator can be asked; gone when none runs.

A hint only: a killed coordinator leaves it behind, and the directory's lock has the last word.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

__all__ = ["BEACON", "Beacon", "light", "quench", "sight"]

BEACON = ".coordinator.json"


class Beacon(NamedTuple):
    """What the file says."""

    run: str
    endpoints: tuple[str, ...]
    pid: int


def light(root: Path, run: str, endpoints: Sequence[str]) -> None:
    """Writes the file."""
    text = json.dumps({"run": run, "endpoints": list(endpoints), "pid": os.getpid()})
    part = root / f"{BEACON}.part"
    part.write_text(text, encoding="utf-8")
    part.replace(root / BEACON)


def quench(root: Path) -> None:
    """Removes the file."""
    (root / BEACON).unlink(missing_ok=True)


def sight(root: Path) -> Beacon | None:
    """Reads the file; `None` when there is none that can be understood."""
    try:
        found = json.loads((root / BEACON).read_text(encoding="utf-8"))
        return Beacon(str(found["run"]), tuple(map(str, found["endpoints"])), int(found["pid"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None
