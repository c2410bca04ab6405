"""A finished dataset on a read-only disk, for example a snapshot."""

from __future__ import annotations

import shutil
import sqlite3
import subprocess
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest

from coordinator.ledger.database.engine import open_writer
from coordinator.ledger.opening import open_run, read_info
from coordinator.ledger.reading.reader import open_ledger
from schemas.errors import WorldError
from tests.builders.ledger import room_catalog, room_plan


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A small disk that tests can remount read-only; requires root."""
    path = tmp_path / "disk"
    path.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=8m", "small", str(path)]
    if shutil.which("mount") is None or subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("mounting a tmpfs needs root")
    yield path
    subprocess.run(["umount", "--lazy", str(path)], check=True)


def protect(disk: Path) -> None:
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)


def test_a_ledger_on_a_read_only_disk_is_read(disk: Path, tmp_path: Path) -> None:
    url, plan = f"sqlite:///{disk / 'ledger.db'}", room_plan(2)
    engine = open_writer(url)
    open_run(engine, plan, room_catalog(tmp_path), 30.0, datetime(2026, 1, 2, tzinfo=UTC))
    engine.dispose()
    protect(disk)
    assert [path.name for path in disk.iterdir()] == ["ledger.db"]
    with open_ledger(url) as ledger:
        assert read_info(ledger).run == plan.run


def test_an_unreadable_write_ahead_log_is_not_ignored(disk: Path) -> None:
    writer = sqlite3.connect(disk / "ledger.db")
    writer.execute("PRAGMA journal_mode=WAL")
    writer.execute("CREATE TABLE info (key, value)")
    writer.commit()
    killed = disk / "killed"  # as after a kill: the write-ahead log exists without its index file
    killed.mkdir()
    for name in ("ledger.db", "ledger.db-wal"):
        shutil.copy(disk / name, killed / name)
    writer.close()
    protect(disk)
    with pytest.raises(WorldError, match="cannot be read"), open_ledger(f"sqlite:///{killed / 'ledger.db'}"):
        pass
