"""Time until the job of a dead worker is pending again, by the timestamps of the ledger, independent of wall time."""

from __future__ import annotations

import threading
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
from tests.builders.wire_worker import WireWorker, until

LATE_S = 1.0
"""Maximum time from the end of the lease until the job is pending again, seconds."""


class SweptClock:
    """Clock that advances by one sweep interval with each sweep of the ledger."""

    def __init__(self, pause_s: float) -> None:
        self._now, self._pause = datetime(2026, 1, 2, tzinfo=UTC), timedelta(seconds=pause_s)

    def __call__(self) -> datetime:
        if threading.current_thread().name == "ledger-writer":
            self._now += self._pause
        return self._now


def times_of(url: str, event: Event) -> list[float]:
    with open_ledger(url) as ledger:
        return [row.at for row in ledger.execute(select(events.c.at).where(events.c.event == event))]


@pytest.mark.parametrize("goes", ["silent", "gone"])
@pytest.mark.parametrize("lease_ttl_s", [2.0, CoordinatorSettings().lease_ttl_s])
def test_the_job_of_a_dead_worker_is_pending_within_its_lease_plus_one_second(
    tmp_path: Path, lease_ttl_s: float, goes: str
):
    clock = SweptClock(CoordinatorSettings().sweep_s)
    settings = CoordinatorSettings(
        reserve_bytes=0, lease_ttl_s=lease_ttl_s, sweep_s=0.005
    )  # sweeps more often than by default, so the test is fast
    url = f"sqlite:///{tmp_path / 'out' / 'ledger.db'}"
    with Coordinator(
        tmp_path / "out",
        room_plan(1),
        room_catalog(tmp_path),
        CoordinatorOptions(
            listen=("tcp/127.0.0.1:0",), settings=settings, clock=clock, elapsed=lambda: clock().timestamp()
        ),
    ) as hub:
        with WireWorker(hub.endpoints, hub.run) as worker:
            worker.job()
            if goes == "gone":
                worker.close()
            until(lambda: len(times_of(url, Event.EXPIRED)) == 1)
        (claimed,), (expired,) = times_of(url, Event.CLAIMED), times_of(url, Event.EXPIRED)
        assert expired - claimed <= lease_ttl_s + LATE_S
        if goes == "silent":
            assert expired - claimed > lease_ttl_s
        assert hub.progress().jobs["pending"] == 1


class SteppedClock:
    """Clock that stands still until the test sets it."""

    def __init__(self) -> None:
        self.now = datetime(2026, 1, 2, tzinfo=UTC)

    def __call__(self) -> datetime:
        return self.now


@pytest.mark.parametrize("holds", ["beats for ever", "announces and does not deliver"])
def test_a_live_worker_holds_a_job_no_longer_than_the_limit(tmp_path: Path, holds: str):
    clock = SteppedClock()
    settings = CoordinatorSettings(reserve_bytes=0, lease_ttl_s=1e6, lease_limit_s=3600.0)
    with Coordinator(
        tmp_path / "out",
        room_plan(1),
        room_catalog(tmp_path),
        CoordinatorOptions(
            listen=("tcp/127.0.0.1:0",), settings=settings, clock=clock, elapsed=lambda: clock().timestamp()
        ),
    ) as hub:
        with WireWorker(hub.endpoints, hub.run) as worker:
            _, lease = worker.job()
            if holds == "announces and does not deliver":
                worker.is_frozen = True
                assert worker.deliver(lease, b"a bundle")
            clock.now += timedelta(seconds=3599)
            assert worker.beat([lease]).lost == ()
            clock.now += timedelta(seconds=2)
            until(lambda: worker.beat([lease]).lost == (lease,))
        (host,) = hub.progress().hosts
        assert (host.host, host.strikes) == (worker.host, 1)
        assert "no episode after 3600 s under one lease" in host.reason
        assert hub.progress().jobs["pending"] == 1
