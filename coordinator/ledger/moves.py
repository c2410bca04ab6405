"""The one way a job changes its state: a compare-and-swap UPDATE and its event row in the same transaction.

Decides nothing: which event happened, and to which lease, is the caller's knowledge.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from types import MappingProxyType
from typing import Any

from sqlalchemy import Boolean, ColumnElement, bindparam, insert, or_, update
from sqlalchemy.engine import Connection

from coordinator.ledger.prepared import PreparedStatement
from coordinator.ledger.states import Event, JobState, sources, target
from coordinator.ledger.tables import attempts, events, jobs
from schemas.wire import Lease

__all__ = ["FREED", "JOB", "UNDER_LEASE", "JobRow", "Transition", "is_in", "lease_parameters", "record_attempt"]

JobRow = Any
"""A row of `jobs` with the columns of `JOB`."""

JOB = tuple(column for column in jobs.c if not isinstance(column.type, Boolean))
"""What a prepared statement returns of a job."""

FREED: Mapping[str, Any] = MappingProxyType(
    {"token": None, "sid": None, "lease_until": None, "step": 0, "sha256": None, "size": None}
)
"""Column values of a job that nobody holds."""

UNDER_LEASE: tuple[ColumnElement[bool], ...] = (
    jobs.c.id == bindparam("of_job"),
    jobs.c.fence == bindparam("of_fence"),
    jobs.c.token == bindparam("of_token"),
)
"""The condition that a lease is the one in force; its parameters are `lease_parameters`."""

_INSERT_EVENT = PreparedStatement(insert(events))
_INSERT_ATTEMPT = PreparedStatement(insert(attempts))


def lease_parameters(lease: Lease) -> dict[str, Any]:
    """Returns what `UNDER_LEASE` compares with."""
    return {"of_job": lease.job_id, "of_fence": lease.fence, "of_token": lease.token}


def is_in(*states: JobState) -> ColumnElement[bool]:
    """Returns the condition that a job is in one of the states."""
    return or_(*(jobs.c.state == state for state in states))  # IN could not be run with many rows of parameters


class Transition:
    """One kind of move, built once: the event, whom it may find, and what it sets.

    Args:
        event: what happens; its source states are part of the UPDATE's condition.
        where: which job, with the fence and token it must still have; compares with bound parameters.
        values: further columns to set, to constants or bound parameters.
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
        """Moves one job if it stands where the event can find it, and logs the event.

        Args:
            connection: within a transaction.
            parameters: values of the bound parameters.
            now: of the event.
            by: worker that caused it; empty for the coordinator itself.
            detail: in words.

        Returns:
            The row after the move; `None` when somebody else won.
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
