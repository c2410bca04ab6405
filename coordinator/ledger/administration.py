"""Executes admin requests in a transaction and records them: retry and cancel jobs, release hosts, pause the run.

The newest requests are stored in the table `info` and not in `events`, because each event belongs to a job. The pause
survives a restart.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import bindparam, select
from sqlalchemy.engine import Connection

from coordinator.ledger import hosts
from coordinator.ledger.database.prepared import PreparedStatement
from coordinator.ledger.opening import write_info
from coordinator.ledger.states import Event, InvalidTransition, JobState, next_state, sources
from coordinator.ledger.tables import info, jobs
from coordinator.ledger.transitions import FREED, Transition
from schemas.protocol.administration import AdminAction, AdminReply, AdminRequest

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
    return _move_all(connection, _RETRY, named=indices, rows=wanted, now=now)


def cancel(connection: Connection, indices: Sequence[int], now: datetime) -> AdminReply:
    """Cancels open episodes; a worker that holds one is notified with the reply to its next heartbeat.

    Args:
        connection: connection with an open transaction.
        indices: episode numbers; empty selects all open episodes.
        now: time of the request.
    """
    wanted = _current(connection, indices, sources(Event.CANCELLED))
    return _move_all(connection, _CANCEL, named=indices, rows=wanted, now=now)


def _current(connection: Connection, indices: Sequence[int], states: Sequence[JobState]) -> list[Any]:
    """Returns the current draws of the given episodes; with empty `indices`, of all episodes in the given states."""
    columns = (jobs.c.id, jobs.c.idx, jobs.c.state, jobs.c.fence)
    current = select(*columns).where(jobs.c.superseded.is_(False)).order_by(jobs.c.idx)
    if not indices:
        return list(connection.execute(current.where(jobs.c.state.in_(states))).all())
    rows: list[Any] = []
    for start in range(0, len(indices), _BATCH):
        rows += connection.execute(current.where(jobs.c.idx.in_(indices[start : start + _BATCH]))).all()
    return rows


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


_PAUSED, _REQUESTS = "paused", "requests"
# keys of the table `info`, not events, because the audit treats an event without a job as damage
_KEPT = 100
_VALUE = PreparedStatement(select(info.c.value).where(info.c.key == bindparam("wanted")))


@dataclass(frozen=True)
class RecordedRequest:
    """Admin request that was executed."""

    action: str
    """Action of the request."""
    at: float
    """Time, seconds since 1970."""
    changed: int
    """Number of episodes and hosts that changed their state."""

    @property
    def time(self) -> datetime:
        """Time in UTC."""
        return datetime.fromtimestamp(self.at, UTC)


def execute(connection: Connection, request: AdminRequest, now: datetime) -> AdminReply:
    """Executes a request and records it. A drain is only recorded: the coordinator executes it.

    Args:
        connection: connection with an open transaction.
        request: the request.
        now: time of the request.
    """
    reply = _change(connection, request, now)
    changed = len(reply.changed) + len(reply.hosts)
    kept = (*read_requests(connection), RecordedRequest(str(request.action), now.timestamp(), changed))
    write_info(connection, {_REQUESTS: json.dumps([asdict(one) for one in kept[-_KEPT:]])})
    return reply


def is_paused(connection: Connection) -> bool:
    """Returns whether no job may be leased until an operator resumes the run."""
    return bool(_read(connection, _PAUSED))


def read_requests(connection: Connection) -> tuple[RecordedRequest, ...]:
    """Returns the newest executed requests, oldest first."""
    return tuple(RecordedRequest(**one) for one in json.loads(_read(connection, _REQUESTS) or "[]"))


def _change(connection: Connection, request: AdminRequest, now: datetime) -> AdminReply:
    match request.action:
        case AdminAction.RETRY:
            return retry(connection, request.indices, now)
        case AdminAction.CANCEL:
            return cancel(connection, request.indices, now)
        case AdminAction.RELEASE:
            return hosts.release(connection, request.hosts)
        case AdminAction.PAUSE | AdminAction.RESUME:
            write_info(connection, {_PAUSED: now.isoformat() if request.action is AdminAction.PAUSE else ""})
        case AdminAction.DRAIN:
            pass
    return AdminReply(changed=())


def _read(connection: Connection, key: str) -> str:
    row = _VALUE.first(connection, {"wanted": key})
    return "" if row is None else str(row.value)
