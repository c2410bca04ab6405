"""The number of cores of a process: affinity, and quotas of control groups of both versions."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from coordinator.defaults import usable_cores


def system(root: Path, group: str, **files: str) -> Path:
    """Writes a file system with control groups."""
    (root / "proc/self").mkdir(parents=True)
    (root / "proc/self/cgroup").write_text(group)
    for name, text in files.items():
        path = root / "sys/fs/cgroup" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


@pytest.fixture
def eight(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)))


@pytest.mark.usefixtures("eight")
@pytest.mark.parametrize(
    ("group", "files", "cores"),
    [
        ("0::/job/task\n", {"job/task/cpu.max": "max 100000\n", "job/cpu.max": "250000 100000\n"}, 3),
        ("0::/\n", {"cpu.max": "50000 100000\n"}, 1),
        ("0::/job\n", {"job/cpu.max": "9900000 100000\n"}, 8),
        ("4:cpu,cpuacct:/job\n", {"cpu/job/cpu.cfs_quota_us": "200000", "cpu/job/cpu.cfs_period_us": "100000"}, 2),
        ("4:cpu:/job\n", {"cpu/job/cpu.cfs_quota_us": "-1", "cpu/job/cpu.cfs_period_us": "100000"}, 8),
        ("3:memory:/job\n", {"memory/job/cpu.max": "100000 100000"}, 8),
        ("damaged\n\n::\n", {"cpu.max": "x y z"}, 8),
    ],
)
def test_the_smallest_limit_counts(tmp_path: Path, group: str, files: dict[str, str], cores: int) -> None:
    assert usable_cores(system(tmp_path, group, **files)) == cores


def test_the_affinity_of_this_process_is_the_limit_without_control_groups(tmp_path: Path) -> None:
    allowed = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {min(allowed)})
        assert usable_cores(tmp_path) == 1
    finally:
        os.sched_setaffinity(0, allowed)
