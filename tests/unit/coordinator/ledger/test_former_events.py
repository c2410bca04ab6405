"""Ledgers of formats 1 to 3 store task and worker failures under older event names, which every reader accepts."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from sqlalchemy import select, update

from coordinator.ledger.opening import open_run, read_info
from coordinator.ledger.reading.audit import find_damage
from coordinator.ledger.reading.farm import read_farm
from coordinator.ledger.reading.records import read_events
from coordinator.ledger.states import FORMER_EVENTS, Event, event_name, recorded_names
from coordinator.ledger.tables import LEDGER_FORMAT, events, info
from schemas.terms import FailReason
from tests.builders.ledger import TTL_S, TimedLedger, room_plan

HISTORY = ["claimed", "task_failed", "claimed", "worker_failed"]


@pytest.fixture
def former_ledger() -> Iterator[TimedLedger]:
    """A ledger of format 3 with a failed and a crashed attempt."""
    ledger = TimedLedger(room_plan(1, crashes=5))
    for reason in (FailReason.TIMEOUT, FailReason.CRASH):
        assert ledger.fail(ledger.lease(), reason)
    with ledger.open() as connection:
        for name, event in FORMER_EVENTS.items():
            assert connection.execute(update(events).where(events.c.event == event).values(event=name)).rowcount == 1
        connection.execute(update(info).where(info.c.key == "format").values(value="3"))
    yield ledger
    ledger.engine.dispose()


def test_events_are_read_by_their_current_names(former_ledger):
    with former_ledger.open() as connection:
        assert [line.event for line in read_events(connection, 1)] == HISTORY
        assert [line.event for line in read_farm(connection, former_ledger.now).events] == HISTORY[::-1]


def test_a_ledger_with_former_names_is_intact(former_ledger):
    with former_ledger.open() as connection:
        assert find_damage(connection, former_ledger.catalog) == ""
        connection.execute(update(events).where(events.c.event == "hurt").values(event="expired"))
        assert "counts 1 worker failures, but 0 are recorded" in find_damage(connection)


def test_an_unknown_event_is_damage(former_ledger):
    with former_ledger.open() as connection:
        connection.execute(update(events).where(events.c.event == "hurt").values(event="injured"))
        assert "wrong value of event" in find_damage(connection)


def test_opening_a_ledger_of_format_3_continues_it_in_the_current_format(former_ledger):
    assert not open_run(former_ledger.engine, former_ledger.plan, former_ledger.catalog, TTL_S, former_ledger.now)
    former_ledger.tick(60)
    assert former_ledger.fail(former_ledger.lease(), FailReason.CRASH)
    with former_ledger.open() as connection:
        assert read_info(connection).format == LEDGER_FORMAT
        recorded = list(connection.execute(select(events.c.event).order_by(events.c.id)).scalars())
        assert recorded == ["claimed", "missed", "claimed", "hurt", "claimed", "worker_failed"]
        assert [line.event for line in read_events(connection, 1)] == [*HISTORY, "claimed", "worker_failed"]
        assert find_damage(connection, former_ledger.catalog) == ""


@pytest.mark.parametrize("event", Event)
def test_every_recorded_name_is_the_name_of_one_event(event):
    assert {event_name(name) for name in recorded_names(event)} == {event.value}
