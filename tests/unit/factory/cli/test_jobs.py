"""`factory jobs pause`, `resume` and `drain` change the run as the web page does."""

from __future__ import annotations

import json
from pathlib import Path

from click.testing import CliRunner

from coordinator.ledger.administration import is_paused, read_requests
from coordinator.ledger.opening import ledger_url_of
from coordinator.ledger.reading.progress import read_progress
from factory.cli.jobs import command
from schemas.errors import UsageError
from tests.builders.ledger import TimedLedger, room_plan


def test_a_run_without_a_coordinator_is_paused_and_resumed(tmp_path: Path) -> None:
    timed_ledger = TimedLedger(room_plan(2), ledger_url_of(tmp_path))
    timed_ledger.engine.dispose()
    paused = CliRunner().invoke(command, ["pause", str(tmp_path)], standalone_mode=False)
    assert paused.exception is None
    assert paused.output == f"paused {tmp_path}\n"
    with timed_ledger.open() as connection:
        assert is_paused(connection)
        assert read_progress(connection, timed_ledger.now).paused
    timed_ledger.engine.dispose()
    resumed = CliRunner().invoke(command, ["resume", str(tmp_path), "--json"], standalone_mode=False)
    assert json.loads(resumed.output)["changed"] == []
    with timed_ledger.open() as connection:
        assert not is_paused(connection)
        assert not read_progress(connection, timed_ledger.now).paused
        assert [request.action for request in read_requests(connection)] == ["pause", "resume"]
    timed_ledger.engine.dispose()


def test_workers_are_drained_by_a_running_coordinator_only(tmp_path: Path) -> None:
    TimedLedger(room_plan(2), ledger_url_of(tmp_path)).engine.dispose()
    refused = CliRunner().invoke(command, ["drain", str(tmp_path)], standalone_mode=False)
    assert isinstance(refused.exception, UsageError)
    assert "only a running coordinator can drain workers" in str(refused.exception)
