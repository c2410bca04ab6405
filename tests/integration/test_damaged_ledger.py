"""Ledgers with flipped bits and wrong values: every command returns a result or an error, never a traceback."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import random
import re
import shutil
import sqlite3
import sys
from contextlib import closing
from pathlib import Path

import pytest

from coordinator.gateway.gather import gather
from coordinator.ledger.reading.audit import ledger_trouble
from coordinator.ledger.tables import METADATA
from coordinator.options import CoordinatorOptions
from coordinator.recovery.repair_dataset import repair
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from factory.cli.main import _run
from schemas.errors import FactoryError
from tests.builders.archived import ArchivedRun
from tests.builders.shared_validator import SharedValidator

READING = (
    ("status", "{}"),
    ("status", "{}", "--json"),
    ("jobs", "list", "{}"),
    ("jobs", "list", "{}", "--state", "archived", "--json"),
    ("jobs", "show", "{}", "1"),
)
TABLES_ONLY = ("stats", "{}")
"""Command that reads no ledger and must therefore work although the ledger of the dataset is damaged."""
WRITING = (("jobs", "retry", "{}", "--all"), ("jobs", "cancel", "{}", "2"))
OPENING = (
    ("run", "--out", "{}"),
    ("coordinator", "start", "--out", "{}"),
    ("repair", "{}"),
    ("gather", "{}"),
    ("report", "{}"),
)
WRONG = ("'x'", "-1", "1e300", "x'fffe'", "9223372036854775807", "''", "NULL", "1.5")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> ArchivedRun:
    """A run with every kind of row: archived, abandoned and pending jobs, failed attempts."""
    return ArchivedRun(tmp_path_factory.mktemp("whole") / "out", planned=4, done=2, misses=3)


@pytest.fixture
def damaged_run(whole: ArchivedRun, tmp_path: Path) -> Path:
    """A copy of the run `whole` that a test can damage."""
    return Path(shutil.copytree(whole.root, tmp_path / "out"))


def call(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], root: Path, words: tuple[str, ...]
) -> int:
    """Returns the exit code of a command; fails on a traceback."""
    monkeypatch.setattr(sys, "argv", ["factory", *(word.format(root) for word in words)])
    try:
        code = _run()
    except SystemExit as error:  # raised by options that exit early
        code = int(error.code or 0)
    said = capsys.readouterr()
    assert code in (0, 1, 2), (words, code, said.err)
    assert "Traceback" not in said.err, (words, said.err)
    return code


def flip(path: Path, seed: int, bits: int) -> None:
    rng, data = random.Random(seed), bytearray(path.read_bytes())
    for _ in range(bits):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    path.write_bytes(data)


@pytest.mark.parametrize("bits", [1, 200])
@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 6))])
def test_every_command_reports_flipped_bits_without_a_traceback(damaged_run, monkeypatch, capsys, seed, bits):
    flip(damaged_run / "ledger.db", seed, bits)
    damaged = (damaged_run / "ledger.db").read_bytes()
    for words in (*READING, TABLES_ONLY, *WRITING, *(OPENING if (seed, bits) == (0, 200) else ())):
        (damaged_run / "ledger.db").write_bytes(damaged)
        call(monkeypatch, capsys, damaged_run, words)


@pytest.mark.parametrize("table", sorted(METADATA.tables))
def test_a_wrong_value_in_any_column_is_reported_without_a_traceback(damaged_run, monkeypatch, capsys, table):
    ledger, verbs = damaged_run / "ledger.db", itertools.cycle((*READING, *WRITING))
    sound = ledger.read_bytes()
    for column in METADATA.tables[table].columns:
        for value in WRONG:
            ledger.write_bytes(sound)
            with closing(sqlite3.connect(ledger)) as raw:
                with contextlib.suppress(sqlite3.IntegrityError, sqlite3.OperationalError):
                    raw.execute(f'UPDATE {table} SET "{column.name}" = {value}')
                raw.commit()
            with contextlib.suppress(FactoryError):
                ledger_trouble(f"sqlite:///{ledger}")
            call(monkeypatch, capsys, damaged_run, next(verbs))
    call(monkeypatch, capsys, damaged_run, TABLES_ONLY)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("UPDATE jobs SET sha256 = NULL WHERE idx = 1", r"an announced job has no bundle \(episode 1\)"),
        ("UPDATE events SET job_id = 999 WHERE id = 1", r"an event belongs to a job that does not exist \(job 999\)"),
        (
            "UPDATE jobs SET not_before = 4e9",
            r"pause of episode \d+ ends \d{9,} s after its last change, but the longest pause is 3600 s",
        ),
    ],
)
def test_damage_is_reported_with_the_number_of_the_episode_or_job(whole, damaged_run, change, said):
    with closing(sqlite3.connect(damaged_run / "ledger.db")) as raw:
        raw.execute(change)
        raw.commit()
    assert re.search(said, ledger_trouble(f"sqlite:///{damaged_run / 'ledger.db'}", whole.catalog))


def _repair_input(whole: ArchivedRun, damaged_run: Path):  # type: ignore[no-untyped-def]
    return dataclasses.replace(
        whole.repair_input(), root=damaged_run, state_dir=damaged_run, url=f"sqlite:///{damaged_run / 'ledger.db'}"
    )


@pytest.mark.parametrize(
    ("table", "column", "value"),
    [
        ("jobs", "state", "'archivfd'"),
        ("jobs", "target_id", "'chair_002'"),
        ("jobs", "attempt", "attempt + 1"),
        ("jobs", "not_before", "4e9"),
        ("jobs", "tier", "x'ff'"),
        ("jobs", "misses", "1"),
        ("jobs", "draw", "draw + 5"),
        ("episodes", "summary", "'{}'"),
        ("episodes", "content_digest", "'0'"),
        ("attempts", "at", "1e300"),
        ("attempts", "outcome", "'oops'"),
        ("events", "fence", "fence + 9"),
        ("info", "value", "'?'"),
    ],
)
def test_coordinator_and_repair_rebuild_a_ledger_with_wrong_values(
    damaged_run: Path, whole: ArchivedRun, checker: SharedValidator, table: str, column: str, value: str
) -> None:
    ledger = damaged_run / "ledger.db"
    with closing(sqlite3.connect(ledger)) as raw:
        raw.execute(f'UPDATE {table} SET "{column}" = {value}')
        raw.commit()
    damaged, files = ledger.read_bytes(), sorted(path.name for path in (damaged_run / "episodes").iterdir())
    url = f"sqlite:///{ledger}"
    assert ledger_trouble(url, whole.catalog)
    with pytest.raises(FactoryError, match="factory repair"):
        gather(_repair_input(whole, damaged_run), [], whole.timed_ledger.now)
    report = repair(_repair_input(whole, damaged_run), checker, whole.timed_ledger.now, apply=True)
    assert "rebuild" in {str(action.kind) for action in report.actions}
    assert ledger_trouble(url, whole.catalog) == ""
    ledger.write_bytes(damaged)
    settings = CoordinatorSettings(reserve_bytes=0, pullers=1)
    options = CoordinatorOptions(listen=("tcp/127.0.0.1:0",), settings=settings, checker=checker)
    with Coordinator(damaged_run, whole.plan, whole.catalog, options) as coordinator:
        assert coordinator.progress().jobs["archived"] == 2
    assert ledger_trouble(url, whole.catalog) == ""
    assert sorted(path.name for path in (damaged_run / "episodes").iterdir()) == files


def test_a_running_coordinator_reports_a_removed_ledger_and_exits(damaged_run, whole):
    settings = CoordinatorSettings(reserve_bytes=0, pullers=1)
    with Coordinator(
        damaged_run, whole.plan, whole.catalog, CoordinatorOptions(listen=("tcp/127.0.0.1:0",), settings=settings)
    ) as coordinator:
        for path in damaged_run.glob("ledger.db*"):
            path.unlink()
        with pytest.raises(FactoryError, match=r"cannot be read|no ledger"):
            coordinator.progress()
