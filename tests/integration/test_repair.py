"""`factory repair` on small damaged datasets with real ledger, archive, tables and validator."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from coordinator.archive.opening import open_archive
from coordinator.ledger.reading.records import read_attempts
from coordinator.recovery.repair_dataset import RepairReport, repair
from coordinator.tables.card import names_split_tables
from coordinator.validation.validator import Validator
from schemas.errors import WorldError
from tests.builders.archived import ArchivedRun


@pytest.fixture(scope="module")
def validator() -> Iterator[Validator]:
    with Validator() as checking:
        yield checking


@pytest.fixture
def run(tmp_path: Path) -> ArchivedRun:
    return ArchivedRun(tmp_path / "out")


def kinds(report: RepairReport) -> Counter[str]:
    return Counter(str(action.kind) for action in report.actions)


def tree(root: Path) -> dict[str, bytes]:
    hidden = {".lock"}
    return {
        str(path.relative_to(root)): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file() and path.name not in hidden and not path.name.endswith(("-shm", "-wal"))
    }


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def flip_thumbnail(table: Path) -> None:
    """Flips a bit in a page of the thumbnails, because Parquet has checksums of pages, but not of the footer."""
    group = pq.read_metadata(table).row_group(0)
    columns = {group.column(place).path_in_schema: group.column(place) for place in range(group.num_columns)}
    pictures = columns["thumbnail.bytes"]
    data = bytearray(table.read_bytes())
    data[pictures.data_page_offset - 8] ^= 1
    table.write_bytes(data)


def mend(run: ArchivedRun, validator: Validator, **options: bool) -> RepairReport:
    report = repair(run.repair_input(), validator, run.timed_ledger.now, apply=options.get("apply", True))
    if report.applied:  # a second repair finds nothing
        assert repair(run.repair_input(), validator, run.timed_ledger.now, apply=False).is_sound
    return report


def test_a_valid_dataset_is_left_unchanged(run, validator):
    before = tree(run.root)
    assert mend(run, validator).is_sound
    assert tree(run.root) == before


def test_a_dry_run_reports_and_changes_nothing(run, validator):
    flip(run.file(2))
    run.file(3).unlink()
    (run.root / "metadata.parquet").unlink()
    before = tree(run.root)
    report = mend(run, validator, apply=False)
    assert kinds(report) == {"quarantine": 1, "requeue": 2, "rewrite": 2}
    assert tree(run.root) == before
    assert report.episodes == 1


@pytest.mark.parametrize("harm", [flip, Path.unlink, lambda path: path.write_bytes(path.read_bytes()[:-7])])
def test_a_damaged_or_missing_episode_is_queued_again_with_its_attempt_number(run, validator, harm):
    attempt = run.timed_ledger.rows(2)[-1].attempt
    harm(run.file(2))
    assert kinds(mend(run, validator))["requeue"] == 1
    assert run.states() == {1: "archived", 2: "pending", 3: "archived"}
    assert run.timed_ledger.rows(2)[-1].attempt == attempt
    assert pq.read_table(run.root / "metadata.parquet")["episode_id"].to_pylist() == ["ep_000001", "ep_000003"]


def test_a_lost_ledger_is_rebuilt_from_plan_and_archive(run, validator):
    files, rows = run.digests(), pq.read_table(run.root / "metadata.parquet")
    (run.root / "ledger.db").unlink()
    report = mend(run, validator)
    assert kinds(report) == {"rebuild": 1, "adopt": 3}
    assert set(run.states().values()) == {"archived"}
    assert run.digests() == files
    assert pq.read_table(run.root / "metadata.parquet").equals(rows)


def test_a_rebuilt_ledger_contains_abandoned_draws_and_failed_attempts(tmp_path, validator):
    run = ArchivedRun(tmp_path / "out", planned=2, done=1, misses=3)
    before = [(row.draw, row.state, row.attempt, row.superseded, row.target_id) for row in run.timed_ledger.rows(1)]
    assert before[0][:4] == (0, "failed", 3, True)
    failed = pq.read_table(run.root / "attempts.parquet")
    (run.root / "ledger.db").unlink()
    mend(run, validator)
    after = [(row.draw, row.state, row.attempt, row.superseded, row.target_id) for row in run.timed_ledger.rows(1)]
    assert [row[0::2] for row in after] == [row[0::2] for row in before]
    assert run.states() == {1: "archived", 2: "pending"}
    with run.timed_ledger.open() as connection:
        outcomes = [(a.attempt, a.outcome) for a in read_attempts(connection, 1)]
    assert outcomes == [(1, "timeout"), (2, "timeout"), (3, "timeout"), (4, "success")]
    assert pq.read_table(run.root / "attempts.parquet").num_rows == failed.num_rows


def test_an_unfinished_episode_resumes_with_its_attempt_and_budget(tmp_path, validator):
    run = ArchivedRun(tmp_path / "out", planned=2, done=0, misses=1)
    (run.root / "ledger.db").unlink()
    mend(run, validator)
    row = run.timed_ledger.rows(1)[-1]
    assert (row.draw, row.attempt, row.misses, row.state) == (0, 2, 1, "pending")


def test_an_episode_without_remaining_draws_stays_failed_after_a_rebuild(tmp_path, validator):
    run = ArchivedRun(tmp_path / "out", planned=1, done=0, misses=6)
    assert run.states() == {1: "failed"}
    (run.root / "ledger.db").unlink()
    mend(run, validator)
    assert run.states() == {1: "failed"}


def test_a_lost_ledger_without_an_attempt_log_is_rebuilt_from_the_files(tmp_path, validator):
    run = ArchivedRun(tmp_path / "out", planned=1, done=1, misses=3)
    for name in ("ledger.db", "attempts.parquet"):
        (run.root / name).unlink()
    mend(run, validator)
    assert [(row.draw, row.state) for row in run.timed_ledger.rows(1)] == [(0, "failed"), (1, "archived")]


def test_a_ledger_from_an_old_backup_adopts_newer_episodes(tmp_path, validator):
    run = ArchivedRun(tmp_path / "out", done=3)
    young = ArchivedRun(tmp_path / "young", done=1)
    shutil.copy(young.root / "ledger.db", run.root / "ledger.db")
    assert kinds(mend(run, validator))["adopt"] == 2
    assert set(run.states().values()) == {"archived"}


def test_a_damaged_ledger_is_kept_in_quarantine_and_rebuilt(run, validator):
    path = run.root / "ledger.db"
    data = bytearray(path.read_bytes())
    data[4096:12288] = b"\xff" * 8192
    path.write_bytes(data)
    assert kinds(mend(run, validator)) == {"rebuild": 1, "adopt": 3}
    kept = [path.read_bytes() for path in (run.root / "quarantine").glob("ledger.db.*") if path.suffix != ".txt"]
    assert bytes(data) in kept


def test_a_foreign_file_among_the_episodes_is_quarantined_with_the_reason(run, validator):
    stray = run.root / "episodes" / "ep_000009.zip"
    stray.write_bytes(run.file(1).read_bytes())
    (run.root / "episodes" / "notes.txt").write_text("mine")
    assert kinds(mend(run, validator)) == {"quarantine": 2}
    reasons = sorted(path.read_text() for path in (run.root / "quarantine").glob("*.reason.txt"))
    assert "the plan has no draw 0 of ep_000009" in reasons[0]
    assert "its name is not that of an episode" in reasons[1]
    assert not stray.exists()


def test_an_episode_of_another_plan_is_not_adopted(run, validator, tmp_path):
    other = ArchivedRun(tmp_path / "other", planned=4, done=2)
    shutil.copy(other.file(2), run.file(2))
    (run.root / "ledger.db").unlink()
    report = mend(run, validator)
    assert kinds(report) == {
        "rebuild": 1,
        "adopt": 2,
        "quarantine": 1,
    }
    (why,) = [action.why for action in report.actions if action.kind == "quarantine"]
    assert "plan_digest" in why or "plan" in why


def test_lost_tables_are_rewritten_from_the_ledger(run, validator):
    before = pq.read_table(run.root / "metadata.parquet")
    for name in ("metadata.parquet", "attempts.parquet", "dataset_meta.json", "README.md"):
        (run.root / name).unlink()
    assert kinds(mend(run, validator)) == {"rewrite": 4}
    assert pq.read_table(run.root / "metadata.parquet").equals(before)


@pytest.mark.parametrize("how", ["missing", "damaged"])
def test_a_split_table_is_rewritten_from_the_episodes(run, validator, how):
    before = tree(run.root)
    (path,) = (run.root / "data").iterdir()
    if how == "missing":
        path.unlink()
    else:
        flip_thumbnail(path)
    (action,) = mend(run, validator).actions
    assert (str(action.kind), action.what) == ("rewrite", f"data/{path.name}")
    after = tree(run.root)
    assert {name for name in before if before[name] != after.get(name)} <= {"dataset_meta.json", "README.md"}
    assert after.keys() == before.keys()


def test_a_dataset_of_an_earlier_version_gets_split_tables(run, validator):
    shutil.rmtree(run.root / "data")
    assert kinds(mend(run, validator)) == {"rewrite": 1}
    assert names_split_tables((run.root / "README.md").read_text())


def test_a_directory_in_use_is_not_changed(run, validator):
    flip(run.file(1))
    before = tree(run.root)
    with open_archive(run.root), pytest.raises(WorldError, match="another coordinator"):
        mend(run, validator)
    assert tree(run.root) == before
