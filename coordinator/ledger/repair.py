"""Brings a ledger that lags behind its archive to where the files are, by the moves of the one table.

A ledger that was lost is one that lags behind by everything. Judges no file; that has been done.
"""

from __future__ import annotations

import secrets
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from types import MappingProxyType
from typing import Any

from sqlalchemy import Row, bindparam, insert, select, update
from sqlalchemy.engine import Connection

from coordinator.failed_attempt import FailedAttempt
from coordinator.ledger import outcomes
from coordinator.ledger.claims import lease_of
from coordinator.ledger.moves import FREED, Move
from coordinator.ledger.opening import insert_planned, planned_of
from coordinator.ledger.states import Event, State
from coordinator.ledger.tables import attempts, jobs
from coordinator.plan.catalog import Catalog
from coordinator.plan.draw import redraw
from coordinator.summary import EpisodeSummary
from schemas.job import episode_id
from schemas.plan import Plan
from schemas.terms import FailReason
from schemas.wire import Done

__all__ = ["REPAIRER", "current_job", "recall", "record_whole"]

REPAIRER = "repair"
"""Stands in the ledger where otherwise a worker's session id does."""
_LEASE_S = 60.0
_SEATED = (jobs.c.id == bindparam("of_job"), jobs.c.fence == bindparam("of_fence"))
_TAKE = Move(
    Event.CLAIMED,
    *_SEATED,
    fence=jobs.c.fence + 1,
    token=bindparam("of_token"),
    sid=bindparam("by"),
    lease_until=bindparam("until"),
    attempt=bindparam("next_attempt"),
)
_EXHAUST = Move(
    Event.EXHAUSTED, *_SEATED, **FREED, superseded=bindparam("has_successor"), reason=bindparam("why"), losses=0
)
_FREE: Mapping[State, Move] = MappingProxyType(
    {
        **{held: Move(Event.RELEASED, *_SEATED, **FREED, not_before=0.0) for held in (State.LEASED, State.SUBMITTED)},
        **{
            ended: Move(Event.RETRIED, *_SEATED, **FREED, not_before=0.0, reason="")
            for ended in (State.FAILED, State.CANCELLED)
        },
    }
)
_WORLD = frozenset(reason.value for reason in FailReason if reason.is_of_the_world)
_TOLD = "as attempts.parquet tells"


def current_job(connection: Connection, index: int) -> Row[Any] | None:
    """Returns the job of an episode that is not superseded."""
    return connection.execute(select(jobs).where(jobs.c.idx == index, jobs.c.superseded.is_(False))).first()


def record_whole(connection: Connection, plan: Plan, catalog: Catalog, summary: EpisodeSummary, now: datetime) -> str:
    """Records a validated file as its episode, however far the ledger lags behind it.

    Returns:
        Why not; nothing when it is done.
    """
    row = _seat(connection, plan, catalog, summary.index, summary.draw, now)
    if isinstance(row, str):
        return row
    if row.attempt > summary.attempt:
        return f"the ledger has seen attempt {summary.attempt} fail"
    row = _take(connection, row, summary.attempt, now)
    done = Done(sid=REPAIRER, lease=lease_of(row), sha256=summary.file_sha256, size=summary.file_bytes)
    outcomes.announce(connection, done, now, _LEASE_S)
    return "" if outcomes.adopt(connection, row.id, summary, now) else "the ledger moved meanwhile"


def recall(
    connection: Connection, plan: Plan, catalog: Catalog, failures: Sequence[FailedAttempt], now: datetime
) -> None:
    """Tells an empty ledger what failed before it was lost, so that no hopeless attempt is tried again.

    Args:
        connection: within a transaction.
        plan: of the run.
        catalog: of its scenes.
        failures: rows of `attempts.parquet`.
        now: of the repair.
    """
    by_episode: dict[str, list[FailedAttempt]] = {}
    for failure in failures:
        by_episode.setdefault(failure.episode_id, []).append(failure)
    for index in range(1, plan.episodes + 1):
        told = by_episode.get(episode_id(index))
        if told:
            _recall_episode(connection, plan, catalog, index, told, now)


def _recall_episode(
    connection: Connection, plan: Plan, catalog: Catalog, index: int, told: list[FailedAttempt], now: datetime
) -> None:
    settled = sorted((row for row in told if row.reason in _WORLD), key=lambda row: row.attempt)
    if settled:
        last = settled[-1]
        tried = sum(row.draw == last.draw for row in settled)
        misses = tried % plan.budget.attempts_per_draw  # an operator's retry grants the whole budget once more
        is_used = misses == 0
        draw = last.draw + 1 if is_used and last.draw + 1 < plan.budget.draws else last.draw
        row = _seat(connection, plan, catalog, index, draw, now)
        if isinstance(row, str):
            return
        after = {"attempt": last.attempt + 1, "misses": misses}
        connection.execute(update(jobs).where(jobs.c.id == row.id).values(after))
        if is_used and draw == last.draw:
            row = _take(connection, row, last.attempt + 1, now)
            _exhaust(connection, row, now, has_successor=False)
    _insert_attempts(connection, index, told)


def _insert_attempts(connection: Connection, index: int, told: Iterable[FailedAttempt]) -> None:
    """Appends the failed attempts of an episode; those at draws that the plan does not have any more are left out."""
    ids = {row.draw: row.id for row in connection.execute(select(jobs.c.draw, jobs.c.id).where(jobs.c.idx == index))}
    seen: Counter[int] = Counter()
    for row in told:
        if row.draw not in ids:
            continue
        settles = row.reason in _WORLD and seen[row.attempt] == 0
        seen[row.attempt] += settles
        connection.execute(
            insert(attempts),
            {
                "job_id": ids[row.draw],
                "idx": index,
                "draw": row.draw,
                "attempt": row.attempt,
                "fence": 0,
                "outcome": row.reason,
                "settles": settles,
                "detail": row.detail,
                "steps": row.steps,
                "seconds": row.seconds,
                "sid": row.worker,
                "at": row.at.timestamp(),
            },
        )


def _seat(connection: Connection, plan: Plan, catalog: Catalog, index: int, draw: int, now: datetime) -> Row[Any] | str:
    """Brings an episode to a draw that waits in the queue; returns its job, or why that cannot be."""
    row = current_job(connection, index)
    if row is None:
        return "the plan has no such episode"
    if row.draw > draw:
        return f"the ledger has given up draw {draw} of it"
    if row.state == State.ARCHIVED:
        return "the ledger owns another file"
    if row.state != State.PENDING:
        row = _made(_FREE[State(row.state)], connection, row, {}, now)
    while row.draw < draw:
        row = _take(connection, row, row.attempt, now)
        _exhaust(connection, row, now, has_successor=True)
        insert_planned(connection, [redraw(plan, catalog, planned_of(row))], now, attempt=row.attempt)
        row = _required(current_job(connection, index))
    return row


def _take(connection: Connection, row: Row[Any], attempt: int, now: datetime) -> Row[Any]:
    values = {
        "of_token": secrets.token_hex(16),
        "by": REPAIRER,
        "until": now.timestamp() + _LEASE_S,
        "next_attempt": attempt,
    }
    return _made(_TAKE, connection, row, values, now)


def _exhaust(connection: Connection, row: Row[Any], now: datetime, *, has_successor: bool) -> None:
    _made(_EXHAUST, connection, row, {"has_successor": has_successor, "why": f"given up before, {_TOLD}"}, now)


def _made(how: Move, connection: Connection, row: Row[Any], values: Mapping[str, Any], now: datetime) -> Row[Any]:
    which = {"of_job": row.id, "of_fence": row.fence}
    return _required(how.make(connection, {**which, **values}, now, by=REPAIRER, detail="by factory repair"))


def _required(row: Row[Any] | None) -> Row[Any]:
    if row is None:
        raise AssertionError("a ledger nobody else writes has moved")
    return row
