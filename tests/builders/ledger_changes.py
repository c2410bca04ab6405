"""Changes a ledger at random with the functions that a run uses; every kind of change occurs. Checks nothing."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from sqlalchemy import select, update

from coordinator.ledger import administration, outcomes
from coordinator.ledger.claims import lease_of
from coordinator.ledger.tables import episodes, jobs
from schemas.protocol.messages import Lease
from schemas.terms import FailReason
from tests.builders.ledger import TTL_S, TimedLedger

__all__ = ["change_at_random", "scatter"]

_REASONS = (FailReason.TIMEOUT, FailReason.COLLISION, FailReason.CRASH, FailReason.RELEASED)


def scatter(timed_ledger: TimedLedger) -> None:
    """Changes the order in which jobs are claimed, so claims are spread over all episode numbers."""
    with timed_ledger.open() as connection:
        connection.execute(update(jobs).values(not_before=(jobs.c.idx * 7919) % 4096 / 4096))


def change_at_random(timed_ledger: TimedLedger, steps: int, seed: int = 0) -> Iterator[str]:
    """Makes changes one by one; yields the name of each."""
    rng = np.random.default_rng(seed)
    held: list[Lease] = []
    for _ in range(steps):
        name = str(rng.choice(["claim", "claim", "archive", "archive", "fail", "lose", "expire", "cancel", "retry"]))
        _CHANGES[name](timed_ledger, held, rng)
        yield name


def _claim(timed_ledger: TimedLedger, held: list[Lease], rng: np.random.Generator) -> None:
    rows = [timed_ledger.claim() for _ in range(int(rng.integers(1, 4)))]
    held += [lease_of(row) for row in rows if row is not None]


def _archive(timed_ledger: TimedLedger, held: list[Lease], rng: np.random.Generator) -> None:
    if held:
        lease = held.pop()
        timed_ledger.done(lease)
        timed_ledger.archive(lease)


def _fail(timed_ledger: TimedLedger, held: list[Lease], rng: np.random.Generator) -> None:
    if held:
        timed_ledger.fail(held.pop(), _REASONS[int(rng.integers(len(_REASONS)))])


def _lose(timed_ledger: TimedLedger, held: list[Lease], rng: np.random.Generator) -> None:
    with timed_ledger.open() as connection:
        archived = list(connection.execute(select(episodes.c.idx).order_by(episodes.c.idx)).scalars())
        if archived:
            outcomes.lose(
                connection, archived[int(rng.integers(len(archived)))], timed_ledger.now, "its file is missing"
            )


def _expire(timed_ledger: TimedLedger, held: list[Lease], rng: np.random.Generator) -> None:
    held.clear()
    timed_ledger.tick(2 * TTL_S)


def _cancel(timed_ledger: TimedLedger, held: list[Lease], rng: np.random.Generator) -> None:
    with timed_ledger.open() as connection:
        administration.cancel(connection, [int(rng.integers(1, timed_ledger.plan.episodes))], timed_ledger.now)


def _retry(timed_ledger: TimedLedger, held: list[Lease], rng: np.random.Generator) -> None:
    with timed_ledger.open() as connection:
        administration.retry(connection, [], timed_ledger.now)


_CHANGES = {
    "claim": _claim,
    "archive": _archive,
    "fail": _fail,
    "lose": _lose,
    "expire": _expire,
    "cancel": _cancel,
    "retry": _retry,
}
