"""A dataset whose ledger has an older format: its episodes stay readable, and `factory repair` rebuilds the ledger."""

from __future__ import annotations

import dataclasses
import sqlite3
import sys
from contextlib import closing
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from coordinator.expansion.catalog import read_entry
from coordinator.gateway.gather import gather
from coordinator.ledger.database.engine import open_writer, sqlite_url, write_closed_digest
from coordinator.ledger.opening import FormerFormat, open_run
from coordinator.ledger.reading.audit import ledger_trouble
from coordinator.ledger.tables import FORMER_FORMATS
from coordinator.options import CoordinatorOptions
from coordinator.recovery.repair_dataset import repair
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from factory.cli.main import _run
from factory.dataset.reader import Dataset
from factory.verify.repair_input import inspect_dataset
from schemas.errors import UsageError
from tests.builders.archived import ArchivedRun
from tests.builders.dataset import NOW, make_dataset
from tests.builders.former_ledger import make_former
from tests.builders.ledger import TimedLedger
from tests.builders.postgres import Postgres
from tests.builders.shared_validator import SharedValidator

SETTINGS = CoordinatorSettings(reserve_bytes=0, pullers=1)
COMMANDS = (
    ("status", "{}"),
    ("jobs", "list", "{}"),
    ("jobs", "show", "{}", "1"),
    ("jobs", "retry", "{}", "--all"),
    ("run", "--out", "{}"),
    ("coordinator", "start", "--out", "{}"),
)


@pytest.fixture(params=FORMER_FORMATS)
def former(request: pytest.FixtureRequest, tmp_path: Path) -> ArchivedRun:
    """A run with an older ledger: three archived episodes, one pending episode, failed attempts."""
    run = ArchivedRun(tmp_path / "out", planned=4, done=3, misses=3)
    with run.timed_ledger.open() as connection:
        make_former(connection, request.param)
    run.timed_ledger.engine.dispose()
    return run


def options(checker: SharedValidator) -> CoordinatorOptions:
    return CoordinatorOptions(listen=("tcp/127.0.0.1:0",), settings=SETTINGS, checker=checker)


def files_of(run: ArchivedRun) -> dict[str, bytes]:
    paths = (path for path in run.root.rglob("*") if path.is_file() and path.name not in (".lock", "ledger.digest"))
    return {str(path.relative_to(run.root)): path.read_bytes() for path in paths}


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_commands_on_an_older_ledger_name_its_format_and_the_remedy(
    former: ArchivedRun, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: tuple[str, ...]
) -> None:
    before = files_of(former)
    monkeypatch.setattr(sys, "argv", ["factory", *(word.format(former.root) for word in words)])
    assert _run() == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "the ledger has format " in said
    assert "of minivla-factory 0.1.0, and this version reads format 4 only" in said
    assert "rebuild it from the episodes with `factory repair DIR`" in said
    assert files_of(former) == before


def test_a_coordinator_does_not_replace_an_older_ledger(former: ArchivedRun, checker: SharedValidator) -> None:
    before = files_of(former)
    write_closed_digest(former.url)  # even if it is unchanged since this version closed it
    with pytest.raises(FormerFormat), Coordinator(former.root, former.plan, former.catalog, options(checker)):
        pass
    assert files_of(former) == before


def test_repair_rebuilds_an_older_ledger_from_the_episodes(former: ArchivedRun, checker: SharedValidator) -> None:
    files, failures = former.digests(), pq.read_table(former.root / "attempts.parquet").num_rows
    now = former.timed_ledger.now
    planned = repair(former.repair_input(), checker, now, apply=False)
    assert [(action.kind, action.what) for action in planned.actions[:1]] == [("rebuild", "ledger")]
    assert planned.actions[0].why.startswith("has format ")
    with pytest.raises(FormerFormat):
        gather(former.repair_input(), [], now)
    repair(former.repair_input(), checker, now, apply=True)
    assert ledger_trouble(former.url, former.catalog) == ""
    assert former.digests() == files
    assert list(former.states().values()) == ["archived"] * 3 + ["pending"]
    assert pq.read_table(former.root / "attempts.parquet").num_rows == failures
    assert repair(former.repair_input(), checker, now, apply=False).is_sound
    with Coordinator(former.root, former.plan, former.catalog, options(checker)) as coordinator:
        assert coordinator.progress().jobs["archived"] == 3
    (kept,) = (path for path in (former.root / "quarantine").glob("ledger.db.*") if path.suffix != ".txt")
    with closing(sqlite3.connect(kept)) as raw:
        assert raw.execute("SELECT count(*) FROM episodes").fetchone() == (3,)


def test_repair_reads_the_plan_from_the_description_of_the_dataset_or_requires_it(tmp_path: Path) -> None:
    root = tmp_path / "out"
    plan = make_dataset(root)
    (package,) = (root / "scenes").glob("*.zip")
    engine = open_writer(sqlite_url(root / "ledger.db"))
    open_run(engine, plan, {"office": read_entry(package)}, 15.0, NOW, planned=())
    with engine.begin() as connection:
        make_former(connection, 3)
    engine.dispose()
    assert inspect_dataset(root, root, None, None, tmp_path / "cache", print).plan == plan
    (root / "dataset_meta.json").unlink()
    with pytest.raises(UsageError, match=r"--plan FILE\.toml"):
        inspect_dataset(root, root, None, None, tmp_path / "cache", print)


def test_an_older_ledger_on_a_server_is_rebuilt_in_an_empty_database(
    tmp_path: Path, postgres_server: Postgres, checker: SharedValidator
) -> None:
    run = ArchivedRun(tmp_path / "out")
    old, empty = postgres_server.new_database(), postgres_server.new_database()
    server_ledger = TimedLedger(run.plan, old, run.catalog)
    with server_ledger.open() as connection:
        make_former(connection, 3)
    server_ledger.engine.dispose()
    now = run.timed_ledger.now
    with pytest.raises(FormerFormat, match="`factory repair DIR` with an empty database as --ledger"):
        repair(dataclasses.replace(run.repair_input(), url=old), checker, now, apply=True)
    report = repair(dataclasses.replace(run.repair_input(), url=empty), checker, now, apply=True)
    assert report.actions[0].kind == "rebuild"
    assert report.episodes == 3
    assert ledger_trouble(empty, run.catalog) == ""


def test_the_episodes_of_an_older_run_stay_readable(former: ArchivedRun) -> None:
    assert len(Dataset(former.root)) == 3
