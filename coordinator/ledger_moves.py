"""The one way a job changes its state: a compare-and-swap UPDATE and its event row in the same transaction.

Decides nothing: which event happened, and to which lease, is the caller's knowledge.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from types import MappingProxyType
from typing import Any

from sqlalchemy import ColumnElement, Row, insert, update
from sqlalchemy.engine import Connection

from coordinator.states import Event, sources, target
from coordinator.tables import attempts, events, jobs
from schemas.wire import Lease

__all__ = ["FREED", "move", "record_attempt", "under_lease"]

FREED: Mapping[str, Any] = MappingProxyType(
    {"token": None, "sid": None, "lease_until": None, "step": 0, "sha256": None, "size": None}
)
"""Column values of a job that nobody holds."""

_INSERT_EVENT = insert(events)
_INSERT_ATTEMPT = insert(attempts)


def under_lease(lease: Lease) -> tuple[ColumnElement[bool], ...]:
    """Returns the condition that a lease is the one in force."""
    return jobs.c.id == lease.job_id, jobs.c.fence == lease.fence, jobs.c.token == lease.token


def move(
    connection: Connection,
    event: Event,
    where: tuple[ColumnElement[bool], ...],
    now: datetime,
    values: Mapping[str, Any],
    *,
    by: str = "",
    detail: str = "",
) -> Row[Any] | None:
    """Moves one job if it stands where the event can find it, and logs the event.

    Args:
        connection: within a transaction.
        event: what happened; its source states are part of the UPDATE's condition.
        where: which job, with the fence and token it must still have.
        now: of the event.
        values: further columns to set.
        by: worker that caused it; empty for the coordinator itself.
        detail: in words.

    Returns:
        The row after the move; `None` when somebody else won.
    """
    statement = (
        update(jobs)
        .where(*where, jobs.c.state.in_(sources(event)))
        .values(state=target(event), changed_at=now.timestamp(), **values)
        .returning(jobs)
    )
    row = connection.execute(statement).first()
    if row is not None:
        connection.execute(
            _INSERT_EVENT,
            {
                "at": now.timestamp(),
                "job_id": row.id,
                "event": event,
                "state": row.state,
                "attempt": row.attempt,
                "fence": row.fence,
                "sid": by,
                "detail": detail,
            },
        )
    return row


def record_attempt(
    connection: Connection,
    before: Row[Any],
    outcome: str,
    now: datetime,
    *,
    settles: bool,
    detail: str = "",
    steps: int = 0,
    seconds: float = 0.0,
) -> None:
    """Appends the outcome of an attempt.

    Args:
        connection: within the transaction of the move.
        before: the job's row as it was under the lease.
        outcome: success, a fail reason or `expired`.
        now: of the outcome.
        settles: whether the attempt has now its one outcome and will not be repeated.
        detail: measured values, in words.
        steps: simulated.
        seconds: of wall time.
    """
    connection.execute(
        _INSERT_ATTEMPT,
        {
            "job_id": before.id,
            "idx": before.idx,
            "draw": before.draw,
            "attempt": before.attempt,
            "fence": before.fence,
            "outcome": outcome,
            "settles": settles,
            "detail": detail,
            "steps": steps,
            "seconds": seconds,
            "sid": before.sid or "",
            "at": now.timestamp(),
        },
    )
