"""Implements admin requests on jobs: retry jobs that ended without an episode, cancel open jobs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import datetime
from typing import Any

from sqlalchemy import bindparam, select
from sqlalchemy.engine import Connection

from coordinator.ledger.states import Event, InvalidTransition, JobState, next_state, sources
from coordinator.ledger.tables import jobs
from coordinator.ledger.transitions import FREED, Transition
from schemas.protocol.administration import AdminReply

_BATCH = 5000
_AS_SEEN = (jobs.c.id == bindparam("of_job"), jobs.c.fence == bindparam("of_fence"))
_RETRY = Transition(Event.RETRIED, *_AS_SEEN, **FREED, misses=0, crashes=0, losses=0, not_before=0.0, reason="")
_CANCEL = Transition(Event.CANCELLED, *_AS_SEEN, **FREED, reason="cancelled by an operator")


def retry(connection: Connection, indices: Sequence[int], now: datetime) -> AdminReply:
    """Puts failed and cancelled episodes back into the queue with new budgets; attempt numbers continue.

    Args:
        connection: connection with an open transaction.
        indices: episode numbers; empty selects all failed episodes.
        now: time of the request.
    """
    wanted = _current(connection, indices, (JobState.FAILED,))
    return _move_all(connection, _RETRY, indices, wanted, now)


def cancel(connection: Connection, indices: Sequence[int], now: datetime) -> AdminReply:
    """Cancels open episodes; a worker that holds one is notified with the reply to its next heartbeat.

    Args:
        connection: connection with an open transaction.
        indices: episode numbers; empty selects all open episodes.
        now: time of the request.
    """
    wanted = _current(connection, indices, sources(Event.CANCELLED))
    return _move_all(connection, _CANCEL, indices, wanted, now)


def _current(connection: Connection, indices: Sequence[int], states: Sequence[JobState]) -> list[Any]:
    """Returns the current draws of the given episodes; with empty `indices`, of all episodes in the given states."""
    columns = (jobs.c.id, jobs.c.idx, jobs.c.state, jobs.c.fence)
    current = select(*columns).where(jobs.c.superseded.is_(False)).order_by(jobs.c.idx)
    if not indices:
        return list(connection.execute(current.where(jobs.c.state.in_(states))).all())
    found: list[Any] = []
    for start in range(0, len(indices), _BATCH):
        found += connection.execute(current.where(jobs.c.idx.in_(indices[start : start + _BATCH]))).all()
    return found


def _move_all(
    connection: Connection, how: Transition, named: Iterable[int], rows: Iterable[Any], now: datetime
) -> AdminReply:
    changed: list[int] = []
    refused = dict.fromkeys(named, "the plan has no episode of that number")
    for row in rows:
        refused.pop(row.idx, None)
        try:
            next_state(JobState(row.state), how.event)
        except InvalidTransition as error:
            refused[row.idx] = str(error)
            continue
        job = {"of_job": row.id, "of_fence": row.fence}
        if how.make(connection, job, now, detail="by an operator") is not None:
            changed.append(row.idx)
    return AdminReply(changed=tuple(changed), refused=refused)
