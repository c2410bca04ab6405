"""Changes the coordinator's clock by hours during a run: running workers keep their jobs, dead workers lose theirs."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from sqlalchemy import select

from coordinator.ledger.reading.reader import open_ledger
from coordinator.ledger.states import Event
from coordinator.ledger.tables import events
from coordinator.options import CoordinatorOptions
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.wire_worker import WireWorker, bundle_for, until

HOURS = timedelta(hours=5)
SWEEPS_S = 1.0


class SetClock:
    """A clock that tests can set."""

    def __init__(self) -> None:
        self.offset = timedelta()

    def __call__(self) -> datetime:
        return datetime.now(UTC) + self.offset


@contextmanager
def running(folder: Path, clock: SetClock, lease_ttl_s: float) -> Iterator[Coordinator]:
    settings = CoordinatorSettings(reserve_bytes=0, pullers=1, lease_ttl_s=lease_ttl_s, sweep_s=0.05)
    catalog = room_catalog(folder)
    with Coordinator(
        folder / "out",
        room_plan(1),
        catalog,
        CoordinatorOptions(listen=("tcp/127.0.0.1:0",), settings=settings, clock=clock),
    ) as hub:
        yield hub


def expiries(folder: Path) -> int:
    with open_ledger(f"sqlite:///{folder / 'out' / 'ledger.db'}") as ledger:
        return len(ledger.execute(select(events.c.at).where(events.c.event == Event.EXPIRED)).all())


@pytest.mark.parametrize("by", [HOURS, -HOURS], ids=["forward", "back"])
def test_a_live_worker_keeps_its_job_and_delivers_its_bundle(tmp_path: Path, by: timedelta) -> None:
    clock = SetClock()
    with running(tmp_path, clock, 30.0) as hub, WireWorker(hub.endpoints, hub.run) as worker:
        job, lease = worker.job()
        clock.offset = by
        time.sleep(SWEEPS_S)
        assert expiries(tmp_path) == 0
        assert worker.deliver(lease, bundle_for(job))
        until(hub.is_finished)
    assert expiries(tmp_path) == 0


@pytest.mark.parametrize("by", [HOURS, -HOURS], ids=["forward", "back"])
def test_the_job_of_a_dead_worker_returns_to_pending(tmp_path: Path, by: timedelta) -> None:
    clock = SetClock()
    with running(tmp_path, clock, 2.0) as hub:
        with WireWorker(hub.endpoints, hub.run) as dead:
            dead.job()
        clock.offset = by
        until(lambda: expiries(tmp_path) == 1)
        with WireWorker(hub.endpoints, hub.run) as other:
            job, lease = other.job()
            assert other.deliver(lease, bundle_for(job))
            until(hub.is_finished)
