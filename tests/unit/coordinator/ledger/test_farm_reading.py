"""What the web page of a run reads from the ledger: cells, running jobs, events and attempts over time."""

from __future__ import annotations

from datetime import timedelta

from coordinator.ledger.claims import lease_of
from coordinator.ledger.reading.farm import read_farm
from schemas.terms import FailReason
from tests.builders.ledger import TimedLedger, room_plan


def test_quotas_running_jobs_and_failures_are_read():
    timed_ledger = TimedLedger(room_plan(3))
    row = timed_ledger.claim()
    assert timed_ledger.fail(lease_of(row), FailReason.TIMEOUT)
    timed_ledger.now += timedelta(minutes=5)
    held = timed_ledger.claim()
    with timed_ledger.open() as connection:
        found = read_farm(connection, timed_ledger.now)
    assert found.cells == {("room", "near", "train_id"): {"leased": 1, "pending": 2}}
    ((sid, jobs),) = found.running.items()
    assert (sid, [job.index for job in jobs]) == (held.sid, [held.idx])
    assert [interval.failures for interval in found.history] == [{"timeout": 1}]
    assert [event.event for event in found.events] == ["claimed", "task_failed", "claimed"]
    assert found.events[0].at == timed_ledger.now


def test_a_new_ledger_has_cells_and_nothing_else():
    timed_ledger = TimedLedger(room_plan(2))
    with timed_ledger.open() as connection:
        found = read_farm(connection, timed_ledger.now)
    assert found.cells == {("room", "near", "train_id"): {"pending": 2}}
    assert (found.running, found.events, found.history, found.requests) == ({}, (), (), ())
