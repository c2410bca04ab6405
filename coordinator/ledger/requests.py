"""Executes admin requests in a transaction and records them; stores whether the run is paused.

The newest requests are stored in the table `info` and not in `events`, because each event belongs to a job. The pause
survives a restart.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from datetime import UTC, datetime

from sqlalchemy import bindparam, select
from sqlalchemy.engine import Connection

from coordinator.ledger import hosts, operator
from coordinator.ledger.database.prepared import PreparedStatement
from coordinator.ledger.opening import write_info
from coordinator.ledger.tables import info
from schemas.protocol.administration import AdminAction, AdminReply, AdminRequest

_PAUSED, _REQUESTS = "paused", "requests"
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
            return operator.retry(connection, request.indices, now)
        case AdminAction.CANCEL:
            return operator.cancel(connection, request.indices, now)
        case AdminAction.RELEASE:
            return hosts.release(connection, request.hosts)
        case AdminAction.PAUSE | AdminAction.RESUME:
            write_info(connection, {_PAUSED: now.isoformat() if request.action is AdminAction.PAUSE else ""})
        case AdminAction.DRAIN:
            pass
    return AdminReply(changed=())


def _read(connection: Connection, key: str) -> str:
    found = _VALUE.first(connection, {"wanted": key})
    return "" if found is None else str(found.value)
