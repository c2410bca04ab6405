"""Checkpoints of a changing ledger: reading only the changed rows gives the same files as reading all rows."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest
from sqlalchemy import text

from coordinator.archive.opening import open_archive
from coordinator.ledger.tables import attempt_tallies, attempts, episodes, job_tallies, jobs
from coordinator.ledger.tallies import ATTEMPT_COUNTS, JOB_COUNTS
from coordinator.tables.checkpoint import Checkpoints, is_checkpoint_due, write_checkpoint
from coordinator.tables.row_groups import GROUP_ROWS
from tests.builders.ledger import TimedLedger, room_plan
from tests.builders.ledger_changes import change_at_random, scatter
from tests.builders.postgres import Postgres

NOW = datetime(2026, 1, 2, tzinfo=UTC)
FILES = ("metadata.parquet", "attempts.parquet", "README.md", "dataset_meta.json")


def read(root: Path) -> dict[str, bytes]:
    return {name: (root / name).read_bytes() for name in FILES}


def rewritten(root: Path, timed_ledger: TimedLedger) -> dict[str, bytes]:
    """Returns the tables that a new process, which must read every row, writes."""
    root.mkdir()
    with open_archive(root) as archive, timed_ledger.engine.connect() as connection:
        write_checkpoint(archive, connection, timed_ledger.plan, timed_ledger.catalog, NOW)
    return read(root)


def test_a_checkpoint_of_the_changes_has_the_bytes_of_completely_rewritten_tables(tmp_path: Path) -> None:
    timed_ledger = TimedLedger(room_plan(2 * GROUP_ROWS + 10, attempts_per_draw=2, draws=3))
    scatter(timed_ledger)
    with open_archive(tmp_path / "data") as archive:
        checkpoints = Checkpoints(archive, timed_ledger.plan, timed_ledger.catalog)
        for step, name in enumerate(change_at_random(timed_ledger, 120)):
            if step % 20 == 0:
                with timed_ledger.engine.connect() as connection:
                    checkpoints.write(connection, NOW)
                    assert not is_checkpoint_due(archive, connection)
                assert read(tmp_path / "data") == rewritten(tmp_path / f"new-{step}", timed_ledger), name


def test_a_checkpoint_reads_only_the_rows_that_have_changed(tmp_path: Path) -> None:
    """Deletes rows without recording an event, as only tests do; the next checkpoint must not notice the deletion."""
    timed_ledger = TimedLedger(room_plan(GROUP_ROWS + 1))
    lease = timed_ledger.lease()
    assert timed_ledger.done(lease)
    assert timed_ledger.archive(lease)
    with open_archive(tmp_path / "data") as archive:
        checkpoints = Checkpoints(archive, timed_ledger.plan, timed_ledger.catalog)
        with timed_ledger.engine.connect() as connection:
            checkpoints.write(connection, NOW)
        before = read(tmp_path / "data")
        with timed_ledger.open() as connection:
            connection.execute(episodes.delete())
        with timed_ledger.engine.connect() as connection:
            checkpoints.write(connection, NOW)
            assert read(tmp_path / "data") == before
            checkpoints.write(connection, NOW, rewrite=True)
        assert read(tmp_path / "data") != before


@pytest.mark.parametrize("server", ["sqlite", "postgresql"])
def test_tallies_equal_the_counted_rows_after_every_change(server: str, request: pytest.FixtureRequest) -> None:
    url = "sqlite://"
    if server == "postgresql":
        postgres: Postgres = request.getfixturevalue("postgres_server")
        url = postgres.new_database()
    timed_ledger = TimedLedger(room_plan(40, attempts_per_draw=2, draws=3), url)
    scatter(timed_ledger)
    names = set()
    try:
        for name in change_at_random(timed_ledger, 150):
            names.add(name)
            assert tallies(timed_ledger) == counted(timed_ledger), name
    finally:
        timed_ledger.engine.dispose()
    assert len(names) == 7


def test_missing_or_wrong_tallies_are_corrected_when_a_ledger_is_opened_for_writing(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'ledger.db'}"
    timed_ledger = TimedLedger(room_plan(20), url)
    list(change_at_random(timed_ledger, 30))
    with timed_ledger.open() as connection:
        for name in ("jobs_insert", "jobs_update", "attempts_insert", "attempts_update"):
            connection.execute(text(f"DROP TRIGGER count_{name}"))
        connection.execute(job_tallies.delete())
        connection.execute(attempt_tallies.update().values(attempts=77))
    before = counted(timed_ledger)
    assert tallies(timed_ledger) != before
    timed_ledger.engine.dispose()
    again = TimedLedger(room_plan(20), url)
    assert tallies(again) == before == counted(again)
    assert again.claim(token="f" * 32) is not None
    assert tallies(again) == counted(again) != before
    again.engine.dispose()


def tallies(timed_ledger: TimedLedger) -> tuple[set[tuple[object, ...]], set[tuple[object, ...]]]:
    with timed_ledger.open() as connection:
        found = connection.execute(JOB_COUNTS).all(), connection.execute(ATTEMPT_COUNTS).all()
    return {tuple(row) for row in found[0] if row.jobs}, {tuple(row) for row in found[1] if row.attempts}


def counted(timed_ledger: TimedLedger) -> tuple[set[tuple[object, ...]], set[tuple[object, ...]]]:
    """Returns the tallies computed by counting the rows one by one."""
    cells: dict[tuple[object, ...], int] = {}
    outcomes: dict[str, tuple[int, int]] = {}
    with timed_ledger.open() as connection:
        for row in connection.execute(jobs.select()):
            cell = (row.state, row.scene, row.tier, row.split, row.superseded)
            cells[cell] = cells.get(cell, 0) + 1
        for row in connection.execute(attempts.select()):
            number, steps = outcomes.get(row.outcome, (0, 0))
            outcomes[row.outcome] = (number + 1, steps + row.steps)
    return {(*cell, number) for cell, number in cells.items()}, {(name, *sums) for name, sums in outcomes.items()}
