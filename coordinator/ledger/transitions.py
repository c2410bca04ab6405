"""Changes the state of a job by a compare-and-swap UPDATE, with an event row in the same transaction.

All state changes use this module. The caller decides which event happened to which lease.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from types import MappingProxyType
from typing import Any

from sqlalchemy import Boolean, ColumnElement, bindparam, insert, or_, update
from sqlalchemy.engine import Connection

from coordinator.ledger.database.prepared import PreparedStatement
from coordinator.ledger.states import Event, JobState, sources, target
from coordinator.ledger.tables import attempts, events, jobs
from schemas.protocol.messages import Lease

JobRow = Any
"""Row of `jobs` with the columns of `JOB`."""

JOB = tuple(column for column in jobs.c if not isinstance(column.type, Boolean))
"""Columns of a job that prepared statements return."""

FREED: Mapping[str, Any] = MappingProxyType(
    {"token": None, "sid": None, "lease_until": None, "step": 0, "sha256": None, "size": None}
)
"""Column values of a job without a lease."""

UNDER_LEASE: tuple[ColumnElement[bool], ...] = (
    jobs.c.id == bindparam("of_job"),
    jobs.c.fence == bindparam("of_fence"),
    jobs.c.token == bindparam("of_token"),
)
"""Condition that a lease is in force; `lease_parameters` returns its parameters."""

_INSERT_EVENT = PreparedStatement(insert(events))
_INSERT_ATTEMPT = PreparedStatement(insert(attempts))


def lease_parameters(lease: Lease) -> dict[str, Any]:
    return {"of_job": lease.job_id, "of_fence": lease.fence, "of_token": lease.token}


def is_in(*states: JobState) -> ColumnElement[bool]:
    return or_(*(jobs.c.state == state for state in states))  # IN does not support executemany


class Transition:
    """Prepared state transition of a job.

    Args:
        event: event; its source states are part of the UPDATE's condition.
        where: conditions on the job, its fence and its token, with bound parameters.
        values: further columns to set to constants or bound parameters.
    """

    def __init__(self, event: Event, *where: ColumnElement[bool], **values: Any) -> None:
        self.event = event
        self._name = event.value
        changes = {"state": target(event), "changed_at": bindparam("now")} | values
        self._update = PreparedStatement(
            update(jobs).where(*where, is_in(*sources(event))).values(changes).returning(*JOB)
        )

    def make(
        self, connection: Connection, parameters: Mapping[str, Any], now: datetime, *, by: str = "", detail: str = ""
    ) -> JobRow | None:
        """Applies the transition to one job if its state allows the event, and records the event.

        Args:
            connection: connection with an open transaction.
            parameters: values of the bound parameters.
            now: time of the event.
            by: session id of the worker that caused the event; empty for the coordinator.
            detail: description.

        Returns:
            The row after the transition; `None` if the job did not match.
        """
        at = now.timestamp()
        row = self._update.first(connection, {**parameters, "now": at})
        if row is not None:
            line = {"job_id": row.id, "event": self._name, "state": row.state, "sid": by, "detail": detail}
            _INSERT_EVENT.count(connection, {**line, "at": at, "attempt": row.attempt, "fence": row.fence})
        return row


def record_attempt(
    connection: Connection,
    before: JobRow,
    outcome: str,
    now: datetime,
    *,
    settles: bool,
    detail: str = "",
    steps: int = 0,
    seconds: float = 0.0,
) -> None:
    """Inserts the outcome of an attempt.

    Args:
        connection: within the transaction of the state change.
        before: row of the job under the lease.
        outcome: success, a fail reason or `expired`.
        now: time of the outcome.
        settles: whether the outcome is final, so the attempt is not repeated.
        detail: description with measured values.
        steps: number of simulated steps.
        seconds: wall time, seconds.
    """
    _INSERT_ATTEMPT.count(
        connection,
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
