"""How an attempt ends: announced, archived, refused by the world, hurt by or hurting a worker, given back, or lost.

Every function is fenced by the lease and idempotent; a lease that is not in force changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from typing import Any, NamedTuple

from sqlalchemy import ColumnElement, Row, delete, insert, select, update
from sqlalchemy.engine import Connection

from coordinator.draw import PlannedJob
from coordinator.ledger import insert_planned, planned_of
from coordinator.ledger_claims import HELD_STATES
from coordinator.ledger_moves import FREED, move, record_attempt, under_lease
from coordinator.states import Event, State
from coordinator.summary import EpisodeSummary
from coordinator.tables import attempts, episodes, jobs, workers
from schemas.plan import Budget
from schemas.wire import Done, Fail, Lease

__all__ = ["SUCCESS", "Announced", "adopt", "announce", "archive", "fail", "is_owned", "lose"]

Successor = Callable[[PlannedJob], PlannedJob]

SUCCESS = "success"
"""Outcome of the one attempt that brought the episode."""
_LOST = "lost"
_HURTS = "crash, hang or invalid bundle"
_CRASH_PAUSE_S = 1.0


class Announced(NamedTuple):
    """What became of an announcement."""

    accepted: bool
    """Whether the lease is, or until its fulfilment was, the worker's."""
    waiting: Row[Any] | None
    """The job, when its bundle is still to be pulled."""


def announce(connection: Connection, done: Done, now: datetime, ttl_s: float) -> Announced:
    """Notes that a bundle can be pulled; repeating it is harmless."""
    known = connection.execute(select(jobs).where(*under_lease(done.lease))).first()
    if known is None or known.state not in (*HELD_STATES, State.ARCHIVED):
        return Announced(False, None)
    if known.state == State.ARCHIVED:
        return Announced(True, None)
    same = (known.state, known.sha256, known.size, known.sid) == (State.SUBMITTED, done.sha256, done.size, done.sid)
    if same:
        return Announced(True, known)
    values = {"sha256": done.sha256, "size": done.size, "sid": done.sid, "lease_until": now.timestamp() + ttl_s}
    row = move(connection, Event.ANNOUNCED, under_lease(done.lease), now, values, by=done.sid)
    return Announced(row is not None, row)


def archive(connection: Connection, lease: Lease, summary: EpisodeSummary, now: datetime) -> bool:
    """Records a published episode if the lease still holds; returns whether the ledger owns the file now."""
    return _own(connection, Event.ARCHIVED, under_lease(lease), summary, now)


def adopt(connection: Connection, job_id: int, summary: EpisodeSummary, now: datetime) -> bool:
    """Records an episode that was published before the coordinator died; its digest must be the announced one."""
    return _own(connection, Event.ADOPTED, (jobs.c.id == job_id,), summary, now)


def fail(connection: Connection, report: Fail, now: datetime, budget: Budget, successor: Successor) -> bool:
    """Settles a failed attempt: the next attempt, the next draw, quarantine, or back to the queue unharmed.

    Args:
        connection: within a transaction.
        report: what failed, under which lease.
        now: of the report.
        budget: how long to insist.
        successor: gives the next draw of the same cell.

    Returns:
        Whether the report was accepted now, or is the repetition of one that was.
    """
    row = connection.execute(select(jobs).where(*under_lease(report.lease), jobs.c.state.in_(HELD_STATES))).first()
    if row is None:
        return _was_reported(connection, report)
    if report.reason.is_of_the_world:
        return _miss(connection, row, report, now, budget, successor)
    if report.reason.is_of_the_worker:
        return _hurt(connection, row, report, now, budget)
    return _release(connection, row, report, now)


def lose(connection: Connection, index: int, now: datetime, detail: str) -> bool:
    """Re-queues an archived episode whose file is gone, under the same attempt, so that the same content comes back."""
    where = (jobs.c.idx == index, jobs.c.superseded.is_(False))
    if move(connection, Event.LOST, where, now, {**FREED, "not_before": 0.0}, detail=detail) is None:
        return False
    succeeded = (attempts.c.idx == index, attempts.c.outcome == SUCCESS)
    connection.execute(update(attempts).where(*succeeded).values(outcome=_LOST, settles=False, detail=detail))
    connection.execute(delete(episodes).where(episodes.c.idx == index))
    return True


def is_owned(connection: Connection, index: int) -> bool:
    """Returns whether the file of an episode is the ledger's, so that no late loser may delete it."""
    return connection.execute(select(episodes.c.idx).where(episodes.c.idx == index)).first() is not None


def _own(
    connection: Connection, event: Event, where: tuple[ColumnElement[bool], ...], summary: EpisodeSummary, now: datetime
) -> bool:
    announced = (jobs.c.idx == summary.index, jobs.c.sha256 == summary.file_sha256)
    row = move(connection, event, (*where, *announced), now, {"lease_until": None, "losses": 0})
    if row is None:
        return False
    record_attempt(connection, row, SUCCESS, now, settles=True, steps=summary.num_steps)
    connection.execute(
        insert(episodes),
        {
            "idx": row.idx,
            "job_id": row.id,
            "attempt": row.attempt,
            "sha256": summary.file_sha256,
            "size": summary.file_bytes,
            "content_digest": summary.content_digest,
            "summary": summary.model_dump_json(),
            "archived_at": now.timestamp(),
        },
    )
    connection.execute(update(workers).where(workers.c.sid == row.sid).values(archived=workers.c.archived + 1))
    return True


def _was_reported(connection: Connection, report: Fail) -> bool:
    same = (attempts.c.job_id == report.lease.job_id, attempts.c.fence == report.lease.fence)
    found = connection.execute(select(attempts.c.outcome).where(*same)).scalar()
    return found == report.reason


def _miss(
    connection: Connection, row: Row[Any], report: Fail, now: datetime, budget: Budget, successor: Successor
) -> bool:
    misses = row.misses + 1
    is_last = misses >= budget.attempts_per_draw
    has_successor = is_last and row.draw + 1 < budget.draws
    values = {
        **FREED,
        "misses": misses,
        "attempt": row.attempt + 1,
        "losses": 0,
        "not_before": now.timestamp(),
        "superseded": has_successor,
        "reason": f"{report.reason}: {report.detail}" if is_last else "",
    }
    event = Event.EXHAUSTED if is_last else Event.MISSED
    if not _settle(connection, event, row, report, now, values, settles=True):
        return False
    if has_successor:
        insert_planned(connection, [successor(planned_of(row))], now, attempt=row.attempt + 1)
    return True


def _hurt(connection: Connection, row: Row[Any], report: Fail, now: datetime, budget: Budget) -> bool:
    crashes = row.crashes + 1
    is_last = crashes >= budget.crashes
    reason = f"quarantined after {crashes} times {_HURTS}, last {report.reason}: {report.detail}" if is_last else ""
    values = {**FREED, "crashes": crashes, "not_before": now.timestamp() + _CRASH_PAUSE_S * crashes, "reason": reason}
    event = Event.QUARANTINED if is_last else Event.HURT
    return _settle(connection, event, row, report, now, values, settles=False)


def _release(connection: Connection, row: Row[Any], report: Fail, now: datetime) -> bool:
    values = {**FREED, "not_before": now.timestamp()}
    return _settle(connection, Event.RELEASED, row, report, now, values, settles=False)


def _settle(
    connection: Connection,
    event: Event,
    row: Row[Any],
    report: Fail,
    now: datetime,
    values: dict[str, Any],
    *,
    settles: bool,
) -> bool:
    detail = f"{report.reason}: {report.detail}"
    if move(connection, event, under_lease(report.lease), now, values, by=report.sid, detail=detail) is None:
        return False
    record_attempt(
        connection,
        row,
        report.reason,
        now,
        settles=settles,
        detail=report.detail,
        steps=report.steps,
        seconds=report.seconds,
    )
    return True
