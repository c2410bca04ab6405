"""Reading the ledger of a dataset: it leaves no additional file, and it reports active workers."""

from __future__ import annotations

from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from sqlalchemy.engine import Engine

from coordinator.archive.staging import Staging
from coordinator.ledger.database.engine import open_writer, sqlite_url
from coordinator.ledger.hosts import note_alive
from coordinator.ledger.opening import open_run
from coordinator.ledger.reading.reader import open_ledger
from coordinator.ledger.reading.records import JobFilter, count_jobs
from factory.dataset.site import site_of
from factory.runs.ledger import plan_of, progress_of
from tests.builders.ledger import room_catalog, room_plan

LEASE_S = 3600.0


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A dataset directory with one worker that has just sent a heartbeat."""
    root = tmp_path / "data"
    with closing(Staging(root, "data")):
        engine = started(root, tmp_path)
        engine.dispose()
    return root


def started(root: Path, scratch: Path) -> Engine:
    engine, now = open_writer(sqlite_url(root / "ledger.db")), datetime.now(UTC)
    open_run(engine, room_plan(2), room_catalog(scratch), LEASE_S, now)
    with engine.begin() as connection:
        note_alive(connection, "worker-1", "host", now + timedelta(seconds=1))
    return engine


def ledger_files(root: Path) -> list[str]:
    return sorted(path.name for path in root.iterdir() if path.name.startswith("ledger.db"))


def test_reading_a_ledger_leaves_no_files_beside_it(data: Path) -> None:
    assert progress_of(site_of(str(data))).planned == 2
    assert plan_of(site_of(str(data))) == room_plan(2)
    assert ledger_files(data) == ["ledger.db"]


def test_a_reader_sees_what_a_running_coordinator_has_committed(data: Path, tmp_path: Path) -> None:
    engine = started(data, tmp_path)
    try:
        before = ledger_files(data)
        with engine.begin() as connection:
            note_alive(connection, "worker-2", "host", datetime.now(UTC))
        assert {worker.sid for worker in progress_of(site_of(str(data))).workers} == {"worker-1", "worker-2"}
        with open_ledger(sqlite_url(data / "ledger.db")) as connection:
            assert count_jobs(connection, JobFilter()) == 2
        assert ledger_files(data) == before
    finally:
        engine.dispose()
    assert ledger_files(data) == ["ledger.db"]


def test_a_worker_is_alive_only_while_a_coordinator_holds_the_directory(data: Path) -> None:
    (worker,) = progress_of(site_of(str(data))).workers
    assert not worker.alive
    with closing(Staging(data, "data")):
        (worker,) = progress_of(site_of(str(data))).workers
        assert worker.alive
