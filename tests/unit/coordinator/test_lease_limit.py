"""A lease older than the limit ends: the job returns to the queue, and the failure counts against the host."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from datetime import timedelta
from typing import Any

import pytest
from sqlalchemy.engine import Connection

from coordinator.housekeeping import LeaseLimit
from coordinator.ledger import claims
from coordinator.ledger.reading.audit import find_damage
from coordinator.ledger.reading.progress import read_progress
from coordinator.protocol.protocol import Terms
from schemas.protocol.messages import Beat, Lease, LeaseProgress
from schemas.protocol.status import HostStatus
from tests.builders.ledger import TTL_S, TimedLedger, room_plan

LIMIT_S = 200.0
EPISODES = 2
STATES = {False: "leased", True: "submitted"}


class Held:
    """A ledger whose workers never stop sending heartbeats, and the lease limit of its coordinator."""

    def __init__(self, timed_ledger: TimedLedger, limit: LeaseLimit) -> None:
        self.timed_ledger, self.limit = timed_ledger, limit
        self.leases: dict[Lease, str] = {}

    def claim(self, sid: str) -> Lease:
        lease = self.timed_ledger.lease(sid)
        self.leases[lease] = sid
        return lease

    def pass_time(self, seconds: float) -> int:
        """Advances the time while every worker sends heartbeats; returns the number of leases ended by the limit."""
        ended, end = 0, self.timed_ledger.now + timedelta(seconds=seconds)
        while self.timed_ledger.now < end:
            self.timed_ledger.tick(min(TTL_S / 2, (end - self.timed_ledger.now).total_seconds()))
            self.beat()
            ended += self.limit.enforce()
        return ended

    def beat(self) -> list[Lease]:
        """Sends one heartbeat for each lease; returns the lost leases."""
        lost: list[Lease] = []
        for lease, sid in self.leases.items():
            with self.timed_ledger.open() as connection:
                told = Beat(sid=sid, live=(LeaseProgress(lease=lease, step=1),))
                lost += claims.beat(connection, told, self.timed_ledger.now, TTL_S).lost
        return lost

    def hosts(self) -> tuple[HostStatus, ...]:
        with self.timed_ledger.open() as connection:
            return read_progress(connection, self.timed_ledger.now).hosts

    def row(self, lease: Lease) -> Any:
        return self.timed_ledger.row(lease.job_id)


@pytest.fixture(params=["sqlite", "postgresql"])
def held(request: pytest.FixtureRequest) -> Iterator[Held]:
    is_server = request.param == "postgresql"
    url = request.getfixturevalue("postgres_server").new_database() if is_server else "sqlite://"
    timed_ledger = TimedLedger(room_plan(EPISODES, crashes=2), url)

    def commit(work: Callable[[Connection], Any]) -> Any:
        with timed_ledger.open() as connection:
            return work(connection)

    terms = Terms(timed_ledger.plan, timed_ledger.catalog, "1", TTL_S, 0.1)
    yield Held(timed_ledger, LeaseLimit(timed_ledger.open, commit, terms, lambda: timed_ledger.now, LIMIT_S))
    timed_ledger.engine.dispose()


@pytest.mark.parametrize("announced", [False, True], ids=["simulating", "announced"])
def test_the_job_of_a_worker_that_only_sends_heartbeats_is_reassigned(held, announced):
    lease = held.claim("bad.1")
    if announced:
        assert held.timed_ledger.done(lease)
    assert held.pass_time(LIMIT_S) == 0
    assert held.beat() == []
    assert held.pass_time(TTL_S) == 1
    assert held.beat() == [lease]
    row = held.row(lease)
    assert (row.state, row.attempt, row.crashes, row.sid) == ("pending", 1, 1, None)
    (host,) = held.hosts()
    assert (host.host, host.strikes) == ("bad", 1)
    assert host.reason == f"hang: no episode after 200 s under one lease; the job is {STATES[announced]}"
    assert not held.timed_ledger.done(lease)
    held.timed_ledger.tick(60)
    assert lease.job_id in {held.timed_ledger.lease("good.1").job_id for _ in range(EPISODES)}
    with held.timed_ledger.open() as connection:
        assert find_damage(connection, held.timed_ledger.catalog) == ""


def test_only_leases_over_the_age_limit_end(held):
    old = held.claim("a.1")
    held.pass_time(LIMIT_S / 2)
    young = held.claim("b.1")
    assert held.pass_time(LIMIT_S / 2 + TTL_S) == 1
    assert held.beat() == [old]
    assert held.row(young).state == "leased"


def test_a_job_that_no_host_completes_within_the_limit_is_abandoned(held):
    for host in ("a.1", "b.1"):
        leases = [held.claim(host) for _ in range(EPISODES)]
        assert held.pass_time(LIMIT_S + TTL_S) == EPISODES
        held.leases.clear()
        held.timed_ledger.tick(60)
    for row in map(held.row, leases):
        assert row.state == "failed"
        assert "no episode after 200 s under one lease" in row.reason


def test_leases_have_the_full_limit_after_a_restart_of_the_coordinator(held):
    lease = held.claim("a.1")
    held.pass_time(LIMIT_S - TTL_S)
    held.limit.restart()
    assert held.pass_time(LIMIT_S - TTL_S) == 0
    assert held.row(lease).state == "leased"
    assert held.pass_time(2 * TTL_S) == 1


def test_the_limit_holds_when_the_clock_was_set_back(held):
    lease = held.claim("a.1")
    held.timed_ledger.now -= timedelta(days=1)
    held.limit.restart()
    assert held.pass_time(LIMIT_S - TTL_S) == 0
    assert held.pass_time(2 * TTL_S) == 1
    assert held.beat() == [lease]
