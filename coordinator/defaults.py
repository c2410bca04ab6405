"""Defaults of the coordinator that its command line shows.

Imports no other module of the product, so help pages are shown fast.

Design: docs/design/program.md#a-command-imports-its-work-when-it-runs.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path

LEASE_TTL_S = 15.0
"""Duration of a lease without a heartbeat, seconds."""
CHECKPOINT_S = 30.0
"""Interval of writing the dataset's tables, seconds."""
MAX_PULLERS = 64
"""Maximum number of bundles that are transferred and validated at a time."""


def usable_cores(root: Path = Path("/")) -> int:
    """Returns the number of cores that this process may use: its CPU affinity, and the CPU quota of its control groups.

    A batch system or a container limits a process in one of these ways, and `os.cpu_count()` knows neither.

    Args:
        root: root of the file system, with `proc` and `sys`.
    """
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quotas = [quota for quota in map(_quota_of, _control_groups(root)) if quota is not None]
    return max(1, min([allowed, *quotas]))


def _control_groups(root: Path) -> Iterator[Path]:
    """Yields the folders of the control groups of this process and of their parents, of both versions."""
    try:
        lines = (root / "proc/self/cgroup").read_text().splitlines()
    except (OSError, UnicodeDecodeError):
        return
    for line in lines:
        _, controllers, place = line.split(":", 2) if line.count(":") >= 2 else ("", "other", "")
        if controllers and "cpu" not in controllers.split(","):
            continue
        base = root / "sys/fs/cgroup" / ("cpu" if controllers else "")
        folder = base / place.lstrip("/")
        yield folder
        yield from (parent for parent in folder.parents if parent == base or base in parent.parents)
        yield base


def _quota_of(folder: Path) -> int | None:
    """Returns the number of cores that a control group permits, rounded up; `None` without a limit."""
    try:
        quota, period = (folder / "cpu.max").read_text().split()
    except (OSError, ValueError):
        try:
            quota, period = ((folder / f"cpu.cfs_{name}_us").read_text().strip() for name in ("quota", "period"))
        except (OSError, UnicodeDecodeError):
            return None
    if not (quota.isdecimal() and period.isdecimal() and int(period)):
        return None
    return max(1, math.ceil(int(quota) / int(period)))


def pullers_for(cores: int) -> int:
    """Returns the number of pullers of a coordinator alone on a host: one per core, as each validates on one core."""
    return min(max(2, cores), MAX_PULLERS)
