"""Memory of a host: the values that the system reports; missing values are `None`."""

from __future__ import annotations

from pathlib import Path

import pytest

from schemas.protocol.messages import HostMemory
from workers.client.heartbeat import read_memory


def test_used_memory_excludes_available_memory(tmp_path: Path) -> None:
    (tmp_path / "meminfo").write_text(
        "MemTotal:   1000 kB\nMemFree:  100 kB\nMemAvailable:   400 kB\nHugePages_Total: 0\n"
    )
    assert read_memory(tmp_path / "meminfo") == HostMemory(used_bytes=600 * 1024, total_bytes=1000 * 1024)


@pytest.mark.parametrize("text", ["", "MemTotal: many kB\n", "MemTotal:\n", "MemTotal: 5 kB\n", "\xff"])
def test_memory_is_unknown_if_the_system_does_not_report_it(tmp_path: Path, text: str) -> None:
    (tmp_path / "meminfo").write_text(text, encoding="latin-1")
    assert read_memory(tmp_path / "meminfo") is None
    assert read_memory(tmp_path / "missing") is None
