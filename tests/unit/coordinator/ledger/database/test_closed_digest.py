"""Digest of a closed ledger: the next start audits the file only if it has changed."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing, suppress

import pytest

from coordinator.archive.opening import open_archive
from coordinator.ledger.database.engine import is_unchanged, write_closed_digest
from coordinator.ledger.run_ledger import RunLedger
from coordinator.recovery.reconcile import replace_unusable_ledger
from schemas.errors import WorldError
from tests.builders.archived import ArchivedRun


@pytest.fixture
def run(tmp_path):
    return ArchivedRun(tmp_path / "out", planned=2, done=1)


def _open_and_close(run: ArchivedRun) -> None:
    with RunLedger(run.url, run.plan.run, lambda: run.timed_ledger.now, 1.0) as ledger:
        ledger.start_writer()
        ledger.writer.call(lambda connection: connection.exec_driver_sql("UPDATE jobs SET misses = misses"))


def _misread(run: ArchivedRun) -> None:
    """Changes a value in a way that only the audit finds."""
    with closing(sqlite3.connect(run.root / "ledger.db")) as raw:
        raw.execute("UPDATE jobs SET attempt = attempt + 7")
        raw.commit()


def test_a_closed_ledger_is_unchanged_until_it_is_written(run):
    assert not is_unchanged(run.url)
    _open_and_close(run)
    assert is_unchanged(run.url)
    _misread(run)
    assert not is_unchanged(run.url)


def test_one_flipped_bit_changes_the_digest(run):
    _open_and_close(run)
    path = run.root / "ledger.db"
    sound = path.read_bytes()
    for at in range(0, len(sound), len(sound) // 7):
        path.write_bytes(sound[:at] + bytes([sound[at] ^ 1]) + sound[at + 1 :])
        assert not is_unchanged(run.url)
    path.write_bytes(sound)
    assert is_unchanged(run.url)


def test_a_ledger_of_a_killed_coordinator_has_no_digest(run, tmp_path):
    _open_and_close(run)
    killed = tmp_path / "killed"
    with RunLedger(run.url, run.plan.run, lambda: run.timed_ledger.now, 1.0) as ledger:
        ledger.start_writer()
        ledger.writer.call(lambda connection: connection.exec_driver_sql("UPDATE jobs SET misses = 1"))
        shutil.copytree(run.root, killed)
    assert not is_unchanged(f"sqlite:///{killed / 'ledger.db'}")


def test_a_ledger_in_which_a_reader_found_damage_has_no_digest(run):
    with RunLedger(run.url, run.plan.run, lambda: run.timed_ledger.now, 1.0) as ledger:
        ledger.start_writer()
        with suppress(WorldError), ledger.reading() as connection:
            connection.exec_driver_sql("SELECT x FROM no_such_table")
    assert not is_unchanged(run.url)


def test_the_start_audits_a_ledger_only_if_it_changed(run):
    _misread(run)
    write_closed_digest(run.url)
    with open_archive(run.root) as archive:
        replace_unusable_ledger(archive, run.url, run.catalog)
        assert (run.root / "ledger.db").exists()
        (run.root / "ledger.digest").unlink()
        replace_unusable_ledger(archive, run.url, run.catalog)
    assert not (run.root / "ledger.db").exists()
