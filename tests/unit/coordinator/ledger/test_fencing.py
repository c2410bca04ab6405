"""A stale worker changes nothing: random sequences of operations of workers, pullers and operators on the real
database."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule, run_state_machine_as_test
from sqlalchemy import select

from coordinator.ledger import administration, claims, outcomes
from coordinator.ledger.claims import HELD_STATES, lease_of
from coordinator.ledger.states import TRANSITIONS, Event, JobState
from coordinator.ledger.tables import attempts, episodes, events, jobs
from schemas.protocol.messages import Beat, Lease, LeaseProgress
from schemas.terms import FailReason
from tests.builders.ledger import TTL_S, TimedLedger, room_plan

ANY_GRANT = st.sampled_from([0, 0, 0, 1, 2, 3, 5, 8])
"""Position of a grant, counted back from the newest grant (0), which is drawn most often."""
ONE_OR_TWO = st.integers(1, 2)
REASON = st.sampled_from([FailReason.TIMEOUT, FailReason.SPAWN, FailReason.CRASH, FailReason.RELEASED])
OTHER_SHA256 = "d" * 64


class Ledger(RuleBasedStateMachine):
    """State machine in which workers keep and reuse every lease."""

    def __init__(self) -> None:
        super().__init__()
        self.grants: list[Lease] = []
        self.newest: dict[int, int] = {}

    def new_database(self) -> str:
        """Returns the URL of an empty database."""
        return "sqlite://"

    @initialize(episodes=st.integers(1, 2), misses=ONE_OR_TWO, draws=ONE_OR_TWO, crashes=ONE_OR_TWO)
    def begin(self, episodes: int, misses: int, draws: int, crashes: int) -> None:
        plan = room_plan(episodes, attempts_per_draw=misses, draws=draws, crashes=crashes)
        self.timed_ledger = TimedLedger(plan, self.new_database())
        self.claim(0)

    def grant(self, number: int) -> Lease:
        return self.grants[-1 - number % len(self.grants)]

    def is_current(self, lease: Lease) -> bool:
        row = self.timed_ledger.row(lease.job_id)
        return row.state in HELD_STATES and (row.fence, row.token) == (lease.fence, lease.token)

    @rule(worker=st.integers(0, 2))
    def claim(self, worker: int) -> None:
        token = self.timed_ledger.new_token()
        row = self.timed_ledger.claim(f"host-{worker}", token)
        if row is not None:
            assert row.fence > self.newest.get(row.id, 0), "every claim raises the fence"
            self.newest[row.id] = row.fence
            self.grants.append(lease_of(row))
            assert self.timed_ledger.claim(f"host-{worker}", token) == row, "a repeated claim finds its job"

    @rule(number=ANY_GRANT, sha256=st.sampled_from(["c" * 64, OTHER_SHA256]))
    def done(self, number: int, sha256: str) -> None:
        lease = self.grant(number)
        was_current, before = self.is_current(lease), self.timed_ledger.rows()
        accepted = self.timed_ledger.done(lease, sha256=sha256)
        fulfilled = (
            self.timed_ledger.row(lease.job_id).state == JobState.ARCHIVED and lease.fence == self.newest[lease.job_id]
        )
        assert accepted == (was_current or fulfilled)
        assert was_current or self.timed_ledger.rows() == before

    @rule(number=ANY_GRANT, reason=REASON)
    def fail(self, number: int, reason: FailReason) -> None:
        lease = self.grant(number)
        was_current, before = self.is_current(lease), self.timed_ledger.rows()
        self.timed_ledger.fail(lease, reason)
        assert was_current or self.timed_ledger.rows() == before, "a stale report changes nothing"

    @rule(number=ANY_GRANT)
    def archive(self, number: int) -> None:
        lease = self.grant(number)
        row, before = self.timed_ledger.row(lease.job_id), self.timed_ledger.rows()
        is_due = self.is_current(lease) and row.state == JobState.SUBMITTED
        assert self.timed_ledger.archive(lease) == is_due
        assert is_due or self.timed_ledger.rows() == before

    @rule(number=ANY_GRANT)
    def beat(self, number: int) -> None:
        lease = self.grant(number)
        was_current, before = self.is_current(lease), self.timed_ledger.rows()
        beat = Beat(sid=self.timed_ledger.holder_of(lease), live=(LeaseProgress(lease=lease, step=3),), spool=(lease,))
        with self.timed_ledger.open() as connection:
            outcome = claims.beat(connection, beat, self.timed_ledger.now, TTL_S)
        assert (lease in outcome.lost) == (lease in outcome.drop) == (not was_current)
        assert was_current or self.timed_ledger.rows() == before

    @rule(seconds=st.sampled_from([0.1, 1.0, TTL_S / 2, TTL_S + 0.1, 40.0]))
    def tick(self, seconds: float) -> None:
        self.timed_ledger.tick(seconds)

    @rule(worker=st.integers(0, 2))
    def lose_to(self, worker: int) -> None:
        """All workers are frozen until their leases have expired; then one worker claims a job."""
        self.timed_ledger.tick(TTL_S + 0.1)
        self.timed_ledger.tick(40.0)
        self.claim(worker)

    @rule(worker=st.integers(0, 2))
    def vanish(self, worker: int) -> None:
        with self.timed_ledger.open() as connection:
            claims.shorten(connection, f"host-{worker}", self.timed_ledger.now, TTL_S / 2)

    @rule(index=st.integers(1, 3), action=st.sampled_from([administration.retry, administration.cancel]))
    def administer(self, index: int, action: Any) -> None:
        with self.timed_ledger.open() as connection:
            action(connection, (index,), self.timed_ledger.now)

    @rule(index=st.integers(1, 3))
    def lose(self, index: int) -> None:
        with self.timed_ledger.open() as connection:
            owned = outcomes.is_recorded(connection, index)
            assert outcomes.lose(connection, index, self.timed_ledger.now, "gone") == owned

    @invariant()
    def ledger_agrees_with_itself(self) -> None:
        with self.timed_ledger.open() as connection:
            rows = connection.execute(select(jobs).order_by(jobs.c.idx, jobs.c.draw)).all()
            owned = {row.idx: row.attempt for row in connection.execute(select(episodes))}
            settled = connection.execute(select(attempts).where(attempts.c.settles)).all()
            log = connection.execute(select(events).order_by(events.c.id)).all()
        _check_leases(rows)
        _check_draws(rows)
        _check_outcomes(rows, owned, settled)
        _check_log(rows, log)

    def teardown(self) -> None:
        if hasattr(self, "timed_ledger"):
            self.timed_ledger.engine.dispose()


def _check_leases(rows: Sequence[Any]) -> None:
    for row in rows:
        held = row.state in HELD_STATES
        assert held == (row.lease_until is not None)
        assert not held or (row.token and row.sid)
        assert row.superseded <= (row.state == JobState.FAILED)


def _check_draws(rows: Sequence[Any]) -> None:
    """Every episode has exactly one current draw, and a later draw never has a smaller attempt number."""
    assert set(Counter(row.idx for row in rows if not row.superseded).values()) == {1}
    for before, after in itertools.pairwise(rows):
        if before.idx == after.idx:
            assert before.superseded
            assert after.attempt >= before.attempt


def _check_outcomes(rows: Sequence[Any], owned: dict[int, int], settled: Sequence[Any]) -> None:
    """An archived episode is recorded once, with the attempt that succeeded; no attempt follows a success."""
    archived = {row.idx: row.attempt for row in rows if row.state == JobState.ARCHIVED}
    assert owned == archived
    assert {row.idx: row.attempt for row in settled if row.outcome == "success"} == archived
    numbers: dict[int, list[int]] = {}
    for row in settled:
        numbers.setdefault(row.idx, []).append(row.attempt)
    for index, found in numbers.items():
        assert sorted(found) == list(range(1, len(found) + 1)), "each attempt is settled once, in order"
        assert max(found) <= archived.get(index, max(found))


def _check_log(rows: Sequence[Any], log: Sequence[Any]) -> None:
    """Every transition is in the transition table and in the event log."""
    states: dict[int, JobState] = {}
    for line in log:
        assert TRANSITIONS[states.get(line.job_id, JobState.PENDING), Event(line.event)] == line.state
        states[line.job_id] = JobState(line.state)
    assert all(states.get(row.id, JobState.PENDING) == row.state for row in rows)


def many(examples: int, steps: int) -> settings:
    checks = list(HealthCheck)
    return settings(
        max_examples=examples, stateful_step_count=steps, deadline=None, suppress_health_check=checks, database=None
    )


def test_stale_workers_change_nothing() -> None:
    run_state_machine_as_test(Ledger, settings=many(10, 20))


@pytest.mark.slow
def test_stale_workers_change_nothing_in_long_sequences_of_events() -> None:
    run_state_machine_as_test(Ledger, settings=many(80, 30))


def test_stale_workers_change_nothing_in_a_ledger_on_a_database_server(postgres_server):
    class OnServer(Ledger):
        def new_database(self) -> str:
            return postgres_server.new_database()

    run_state_machine_as_test(OnServer, settings=many(8, 20))
