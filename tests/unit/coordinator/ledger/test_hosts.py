"""Failing hosts pause, are barred and released; jobs are abandoned only after failures on several hosts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from datetime import timedelta
from typing import Any

import pytest
from sqlalchemy import func, select

from coordinator.ledger import hosts
from coordinator.ledger.reading.progress import read_progress
from coordinator.ledger.tables import jobs
from coordinator.protocol.protocol import ParsedRequest, Terms, parse, serve
from schemas.base import Model
from schemas.protocol.administration import AdminAction, AdminReply, AdminRequest
from schemas.protocol.messages import Ack, Beat, Claim, ClaimReply, Done, Fail, Hello, Lease
from schemas.protocol.status import HostStatus
from schemas.terms import FailReason
from tests.builders.ledger import TTL_S, TimedLedger, room_plan

HARM = [reason for reason in FailReason if reason.is_worker_failure]
EPISODES = 20


class Counter:
    """Sends requests of hosts through the protocol checks to a ledger with a test clock."""

    def __init__(self, timed_ledger: TimedLedger) -> None:
        self.timed_ledger = timed_ledger
        self.terms = Terms(timed_ledger.plan, timed_ledger.catalog, "1", TTL_S, 0.1)

    def ask(self, host: str, verb: str, message: Model) -> Any:
        request = parse(verb, host, message.model_dump_json().encode())
        assert isinstance(request, ParsedRequest), request
        with self.timed_ledger.open() as connection:
            return serve(connection, request, self.terms, self.timed_ledger.now).reply

    def hello(self, host: str) -> None:
        self.ask(host, "hello", Hello(sid=f"{host}.1", host=host, slots=4, version="1"))

    def claim(self, host: str) -> ClaimReply:
        reply = self.ask(host, "claim", Claim(sid=f"{host}.1", token=self.timed_ledger.new_token()))
        assert isinstance(reply, ClaimReply)
        return reply

    def fail(self, host: str, lease: Lease, reason: FailReason = FailReason.INVALID) -> None:
        report = Fail(sid=f"{host}.1", lease=lease, reason=reason, detail="7 bytes")
        assert self.ask(host, "fail", report) == Ack(accepted=True)

    def succeed(self, host: str, lease: Lease) -> None:
        assert self.ask(host, "done", Done(sid=f"{host}.1", lease=lease, sha256="c" * 64, size=1000)).accepted
        assert self.timed_ledger.archive(lease)

    def spoil(self, host: str, seconds: float, reason: FailReason = FailReason.INVALID) -> int:
        """Lets a host fail every job that it claims, for a number of seconds; returns the number of failed jobs."""
        end, spoilt = self.timed_ledger.now + timedelta(seconds=seconds), 0
        while self.timed_ledger.now < end:
            reply = self.claim(host)
            if reply.lease is not None:
                self.fail(host, reply.lease, reason)
                spoilt += 1
            self.timed_ledger.tick(max(0.01, reply.retry_after_s))
        return spoilt

    def troubled(self) -> tuple[HostStatus, ...]:
        with self.timed_ledger.open() as connection:
            return read_progress(connection, self.timed_ledger.now).hosts

    def counts(self) -> dict[str, int]:
        with self.timed_ledger.open() as connection:
            return read_progress(connection, self.timed_ledger.now).jobs


@pytest.fixture(params=["sqlite", "postgresql"])
def counter(request: pytest.FixtureRequest) -> Iterator[Counter]:
    is_server = request.param == "postgresql"
    url = request.getfixturevalue("postgres_server").new_database() if is_server else "sqlite://"
    timed_ledger = TimedLedger(room_plan(EPISODES), url)
    yield Counter(timed_ledger)
    timed_ledger.engine.dispose()


@pytest.mark.parametrize("reason", HARM)
@pytest.mark.parametrize("has_neighbour", [False, True])
def test_a_host_that_fails_every_job_is_barred_and_no_job_is_abandoned(counter, reason, has_neighbour):
    if has_neighbour:
        counter.hello("good")
    spoilt = counter.spoil("bad", 600, reason)
    assert counter.counts()["failed"] == 0
    assert spoilt <= hosts.STRIKES
    (found,) = counter.troubled()
    assert (found.host, found.strikes, found.reason) == ("bad", hosts.STRIKES, f"{reason}: 7 bytes")
    assert found.barred_at is not None
    counter.timed_ledger.tick(3600)
    assert counter.claim("bad").job is None
    assert counter.claim("good").job is not None


def test_no_job_is_abandoned_if_one_host_fails_all_jobs_at_once(counter):
    for _ in range(5):
        leases = []
        while (reply := counter.claim("bad")).lease is not None:
            leases.append(reply.lease)
        for lease in leases:
            counter.fail("bad", lease)
        counter.timed_ledger.tick(120)
    assert counter.counts()["failed"] == 0
    assert counter.counts()["pending"] == EPISODES


def test_a_host_pauses_longer_after_each_strike_and_then_has_one_job_at_a_time(counter):
    pauses = []
    for _ in range(3):
        lease = counter.claim("bad").lease
        counter.fail("bad", lease)
        pauses.append(counter.claim("bad").retry_after_s)
        counter.timed_ledger.tick(pauses[-1])
    assert pauses == [1, 2, 4]
    assert counter.claim("bad").job is not None
    assert counter.claim("bad").job is None
    assert counter.claim("good").job is not None


def test_failures_of_jobs_claimed_before_a_pause_count_once(counter):
    leases = [counter.claim("bad").lease for _ in range(10)]
    for lease in leases:
        counter.fail("bad", lease)
    assert [host.strikes for host in counter.troubled()] == [1]


def test_archived_episodes_reduce_strikes(counter):
    counter.spoil("shaky", 8)
    before = counter.troubled()[0].strikes
    while counter.troubled():
        reply = counter.claim("shaky")
        if reply.lease is None:
            counter.timed_ledger.tick(reply.retry_after_s)
        else:
            counter.succeed("shaky", reply.lease)
    assert before > 2
    leases = [counter.claim("shaky").lease for _ in range(3)]
    assert None not in leases


def test_a_released_host_gets_jobs_again(counter):
    counter.spoil("bad", 600)
    request = AdminRequest(action=AdminAction.RELEASE, hosts=("bad", "unknown"))
    reply = counter.ask("operator", "admin", request)
    assert reply.hosts == ("bad",)
    assert list(reply.refused_hosts) == ["unknown"]
    assert counter.troubled() == ()
    assert counter.claim("bad").job is not None
    assert counter.ask("operator", "admin", AdminRequest(action=AdminAction.RELEASE)) == AdminReply(changed=())


def test_a_job_that_fails_on_every_host_is_abandoned(counter):
    target = counter.claim("one")
    counter.fail("one", target.lease)
    others = [counter.claim("other").lease for _ in range(EPISODES - 1)]
    assert None not in others
    for host in ("two", "other"):
        while (reply := counter.claim(host)).job is None:
            counter.timed_ledger.tick(1)
            counter.ask("other", "beat", Beat(sid="other.1", spool=tuple(others)))
        assert reply.job.index == target.job.index
        counter.fail(host, reply.lease)
    assert counter.counts()["failed"] == 1


def test_a_job_that_fails_on_two_hosts_is_not_abandoned_if_another_host_can_try_the_job(counter):
    kept = tuple(counter.claim("good").lease for _ in range(EPISODES - 1))
    for _ in range(400):
        for host in ("hostile", "faulty"):
            if (lease := counter.claim(host).lease) is not None:
                counter.fail(host, lease)
        counter.timed_ledger.tick(5)
        counter.ask("good", "beat", Beat(sid="good.1", spool=kept))
    with counter.timed_ledger.open() as connection:
        crashes = connection.execute(select(func.max(jobs.c.crashes))).scalar_one()
    assert crashes >= counter.timed_ledger.plan.budget.crashes
    assert counter.counts()["failed"] == 0
    assert [host.barred_at is not None for host in counter.troubled()] == [True, True]


def test_a_job_that_fails_on_both_of_two_hosts_is_abandoned(counter):
    first, *others = [counter.claim("one").lease for _ in range(EPISODES)]
    counter.fail("one", first)
    for failures in (1, 2):
        assert counter.counts()["failed"] == 0, failures
        while (lease := counter.claim("two").lease) is None:
            counter.timed_ledger.tick(1)
            counter.ask("one", "beat", Beat(sid="one.1", spool=tuple(others)))
        counter.fail("two", lease)
    assert counter.counts()["failed"] == 1


def test_a_job_that_fails_on_the_only_host_is_abandoned_after_a_long_time(counter):
    """The host delivers all other episodes, so it is not barred."""
    counter.terms = replace(counter.terms, retry_after_s=1.0)
    started, tries = counter.timed_ledger.now, 0
    while not tries or counter.counts()["failed"] == 0:
        reply = counter.claim("only")
        while reply.job is None or reply.job.index != 1:
            if reply.job is None:
                counter.timed_ledger.tick(reply.retry_after_s)
            else:
                counter.succeed("only", reply.lease)
            reply = counter.claim("only")
        tries += 1
        counter.fail("only", reply.lease)
    assert tries > hosts.STRIKES
    assert counter.timed_ledger.now - started > timedelta(minutes=2)
    assert counter.counts()["archived"] == EPISODES - 1
    assert all(host.barred_at is None for host in counter.troubled())


def test_a_host_that_repeatedly_fails_one_job_is_barred_if_other_hosts_could_try_the_job(counter):
    counter.hello("good")
    target = counter.claim("bad")
    others = [counter.claim("good").lease for _ in range(EPISODES - 1)]
    lease = target.lease
    for _ in range(60):
        if lease is not None:
            counter.fail("bad", lease)
        counter.timed_ledger.tick(5)
        counter.ask("good", "beat", Beat(sid="good.1", spool=tuple(others)))
        lease = counter.claim("bad").lease
    assert counter.counts()["failed"] == 0
    assert counter.troubled()[0].barred_at is not None
