"""A coordinator that starts on a dataset whose ledger was lost, restored from an older copy, or damaged."""

from __future__ import annotations

import dataclasses
import random
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from coordinator.expansion.catalog import read_entry
from coordinator.ledger.database.engine import open_writer, sqlite_url
from coordinator.ledger.opening import open_run
from coordinator.ledger.reading.audit import ledger_trouble
from coordinator.options import CoordinatorOptions
from coordinator.recovery.repair_dataset import repair
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from coordinator.validation.validator import Validator
from factory.dataset.site import site_of
from factory.runs.ledger import plan_of, progress_of
from factory.verify.repair_input import inspect_dataset
from schemas.errors import UsageError, WorldError
from tests.builders.archived import ArchivedRun
from tests.builders.dataset import NOW, make_dataset
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.plan import small_plan

SETTINGS = CoordinatorSettings(reserve_bytes=0, pullers=1)


@pytest.fixture(scope="module")
def validator() -> Iterator[Validator]:
    with Validator() as checking:
        yield checking


@pytest.fixture
def run(tmp_path: Path) -> ArchivedRun:
    return ArchivedRun(tmp_path / "out")


def start(run: ArchivedRun) -> None:
    """Starts a coordinator on the dataset and stops it."""
    with Coordinator(
        run.root, run.plan, run.catalog, CoordinatorOptions(listen=("tcp/127.0.0.1:0",), settings=SETTINGS)
    ):
        pass


def quarantined(run: ArchivedRun) -> list[str]:
    """Returns the episodes in quarantine."""
    return [path.name for path in (run.root / "quarantine").glob("ep_*.zip.????????")]


def ledger(run: ArchivedRun) -> Path:
    return run.root / "ledger.db"


def delete(path: Path) -> None:
    path.unlink()


def truncate(path: Path) -> None:
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size // 2)


def empty(path: Path) -> None:
    path.write_bytes(b"")


def flip(path: Path) -> None:
    rng, data = random.Random(1), bytearray(path.read_bytes())
    for _ in range(200):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    path.write_bytes(data)


def text_instead(path: Path) -> None:
    path.write_text("not a database\n" * 1000)


def drop_a_table(path: Path) -> None:
    with closing(sqlite3.connect(path)) as raw:
        raw.execute("DROP TABLE episodes")
        raw.commit()


ACCIDENTS: list[Callable[[Path], None]] = [delete, truncate, empty, flip, text_instead, drop_a_table]


@pytest.mark.parametrize("accident", ACCIDENTS)
def test_a_start_after_losing_the_ledger_keeps_every_whole_episode(run, accident):
    files, rows = run.digests(), pq.read_table(run.root / "metadata.parquet")
    accident(ledger(run))
    start(run)
    assert set(run.states().values()) == {"archived"}
    assert run.digests() == files
    assert quarantined(run) == []
    assert pq.read_table(run.root / "metadata.parquet").equals(rows)
    assert ledger_trouble(run.url, run.catalog) == ""


@pytest.mark.parametrize("tables", ["with tables", "without tables"])
def test_a_start_with_an_older_ledger_adopts_newer_episodes(tmp_path, tables):
    young = ArchivedRun(tmp_path / "young", planned=4, done=0, misses=1)
    run = ArchivedRun(tmp_path / "out", planned=4, done=3, misses=3)
    files = run.digests()
    failed = pq.read_table(run.root / "attempts.parquet").num_rows
    shutil.copy(young.root / "ledger.db", ledger(run))
    if tables == "without tables":
        for name in ("metadata.parquet", "attempts.parquet", "dataset_meta.json"):
            (run.root / name).unlink()
    start(run)
    assert run.digests() == files
    assert quarantined(run) == []
    assert list(run.states().values()) == ["archived"] * 3 + ["pending"]
    recalled = pq.read_table(run.root / "attempts.parquet").num_rows
    assert recalled == (failed if tables == "with tables" else 1)


def test_the_write_ahead_log_of_a_lost_ledger_is_not_replayed_into_the_next_ledger(run, tmp_path):
    other = ArchivedRun(tmp_path / "other", planned=5, done=2)
    with closing(sqlite3.connect(other.root / "ledger.db", isolation_level=None)) as raw:
        raw.execute("UPDATE jobs SET reason = 'of another run'")
        shutil.copy(other.root / "ledger.db-wal", run.root / "ledger.db-wal")
        shutil.copy(other.root / "ledger.db-shm", run.root / "ledger.db-shm")
    ledger(run).unlink()
    start(run)
    assert set(run.states().values()) == {"archived"}
    assert all(row.reason == "" for row in run.timed_ledger.rows())
    assert quarantined(run) == []


def test_failed_attempts_and_abandoned_draws_are_restored_at_a_start_without_a_ledger(tmp_path):
    run = ArchivedRun(tmp_path / "out", planned=2, done=0, misses=3)
    before = [(row.draw, row.state, row.attempt, row.misses, row.target_id) for row in run.timed_ledger.rows(1)]
    failed = pq.read_table(run.root / "attempts.parquet")
    ledger(run).unlink()
    start(run)
    assert [(row.draw, row.state, row.attempt, row.misses, row.target_id) for row in run.timed_ledger.rows(1)] == before
    assert pq.read_table(run.root / "attempts.parquet").num_rows == failed.num_rows
    assert ledger_trouble(run.url, run.catalog) == ""


def test_an_attempt_log_of_another_run_changes_no_draw_and_no_attempt_number(tmp_path):
    run = ArchivedRun(tmp_path / "out", planned=2, done=0)
    other = ArchivedRun(tmp_path / "other", planned=3, done=0, misses=3)
    table = pq.read_table(other.root / "attempts.parquet")
    strange = table.set_column(table.schema.get_field_index("target_id"), "target_id", [["chair_999"] * table.num_rows])
    pq.write_table(strange, run.root / "attempts.parquet")
    ledger(run).unlink()
    start(run)
    assert [(row.idx, row.draw, row.attempt) for row in run.timed_ledger.rows()] == [(1, 0, 1), (2, 0, 1)]


def test_a_damaged_episode_is_simulated_again_and_intact_ones_are_kept(run):
    ledger(run).unlink()
    data = bytearray(run.file(2).read_bytes())
    data[len(data) // 2] ^= 1
    run.file(2).write_bytes(data)
    start(run)
    assert run.states() == {1: "archived", 2: "pending", 3: "archived"}
    assert [name[:13] for name in quarantined(run)] == ["ep_000002.zip"]


def test_an_intact_episode_file_is_kept_if_its_recorded_size_is_wrong(run):
    files = run.digests()
    with closing(sqlite3.connect(ledger(run))) as raw:
        raw.execute("UPDATE episodes SET size = size + 1, summary = json_set(summary, '$.file_bytes', size + 1)")
        raw.commit()
    start(run)
    assert set(run.states().values()) == {"archived"}
    assert run.digests() == files
    assert quarantined(run) == []


def test_another_plan_on_a_directory_without_ledger_is_refused_and_moves_nothing(run):
    files = run.digests()
    ledger(run).unlink()
    other = room_plan(7)
    with (
        pytest.raises(UsageError, match="none belongs to run room"),
        Coordinator(
            run.root,
            other,
            room_catalog(run.root.parent),
            CoordinatorOptions(listen=("tcp/127.0.0.1:0",), settings=SETTINGS),
        ),
    ):
        pass
    assert run.digests() == files
    assert quarantined(run) == []


def test_a_ledger_of_another_plan_is_named_at_the_start_and_set_aside_by_repair(run, tmp_path, validator):
    other = ArchivedRun(tmp_path / "other", planned=5, done=2)
    shutil.copy(other.root / "ledger.db", ledger(run))
    files, site = run.digests(), site_of(str(run.root))
    with pytest.raises(WorldError, match=r"is of run room-\w+, but dataset_meta.json of .*`factory repair"):
        plan_of(site)
    repair_input = dataclasses.replace(run.repair_input(), foreign_ledger="is of another run")
    report = repair(repair_input, validator, run.timed_ledger.now, apply=True)
    assert report.episodes == 3
    assert run.digests() == files
    assert set(run.states().values()) == {"archived"}
    assert plan_of(site) == run.plan


def test_the_plan_of_the_episodes_is_used_if_ledger_and_description_have_different_plans(tmp_path):
    plan = make_dataset(tmp_path / "out")
    (package,) = (tmp_path / "out" / "scenes").iterdir()
    engine = open_writer(sqlite_url(tmp_path / "out" / "ledger.db"))
    open_run(engine, small_plan(9), {"office": read_entry(package)}, 15.0, NOW, planned=())
    engine.dispose()
    repair_input = inspect_dataset(tmp_path / "out", tmp_path / "out", None, None, tmp_path / "cache", print)
    assert repair_input.plan == plan
    assert "the episodes to run" in repair_input.foreign_ledger
    with pytest.raises(UsageError, match="the directory contains run"):
        inspect_dataset(tmp_path / "out", tmp_path / "out", small_plan(7), None, tmp_path / "cache", print)


def test_a_directory_without_a_ledger_keeps_its_original_plan(run):
    ledger(run).unlink()
    assert plan_of(site_of(str(run.root))) == run.plan


def test_status_without_a_ledger_suggests_repair_instead_of_a_new_run(run):
    ledger(run).unlink()
    with pytest.raises(WorldError, match="factory repair") as said:
        progress_of(site_of(str(run.root)))
    assert "factory run" not in str(said.value)


def test_repair_restores_intact_episodes_from_quarantine(run, validator):
    files = run.digests()
    for index in (1, 3):
        run.file(index).rename(run.root / "quarantine" / f"ep_{index:06d}.zip.0badcafe")
        (run.root / "quarantine" / f"ep_{index:06d}.zip.0badcafe.reason.txt").write_text("a mistake")
    bad = bytearray(run.file(2).read_bytes())
    bad[len(bad) // 2] ^= 1
    (run.root / "quarantine" / "ep_000002.zip.00000000").write_bytes(bad)
    start(run)  # queues two episodes again, as older coordinators did after such a move
    assert run.states() == {1: "pending", 2: "archived", 3: "pending"}
    report = repair(run.repair_input(), validator, run.timed_ledger.now, apply=True)
    assert [str(action.kind) for action in report.actions if action.what.startswith("quarantine")] == ["restore"] * 2
    assert run.digests() == files
    assert set(run.states().values()) == {"archived"}
    assert [path.name for path in (run.root / "quarantine").iterdir()] == ["ep_000002.zip.00000000"]
    assert repair(run.repair_input(), validator, run.timed_ledger.now, apply=False).is_sound
