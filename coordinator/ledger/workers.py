"""Who works for the run: introductions and signs of life of workers, a bounded number of them. Touches no job."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import bindparam, delete, func, insert, select, update
from sqlalchemy.engine import Connection

from coordinator.ledger.prepared import PreparedStatement
from coordinator.ledger.tables import workers
from schemas.wire import Hello

__all__ = ["SESSIONS", "SESSIONS_OF_HOST", "note_alive", "register"]

SESSIONS, SESSIONS_OF_HOST = 10_000, 2000
"""Most sessions that are known, in all and of one host: twice as many as can be connected."""
_SILENT_S = 300.0
"""Silence after which a session is forgotten where there is no room for another."""

_OLDEST = func.min(workers.c.last_beat).label("oldest")
_KNOWN: Any = select(func.count().label("known"), _OLDEST).select_from(workers)
_OF_ALL = PreparedStatement(_KNOWN)
_OF_HOST = PreparedStatement(_KNOWN.where(workers.c.host == bindparam("name")))
_HEARD = PreparedStatement(update(workers).where(workers.c.sid == bindparam("by")).values(last_beat=bindparam("now")))


def register(connection: Connection, hello: Hello, now: datetime) -> bool:
    """Records a worker, or what it says of itself now; returns whether there was room for it."""
    values = {"host": hello.host, "slots": hello.slots, "version": hello.version, "last_beat": now.timestamp()}
    if connection.execute(update(workers).where(workers.c.sid == hello.sid).values(values)).rowcount:
        return True
    if not _make_room(connection, hello.host, now):
        return False
    connection.execute(insert(workers).values(sid=hello.sid, **values))
    return True


def note_alive(connection: Connection, sid: str, host: str, now: datetime) -> None:
    """Records that a worker was heard of, introduced or not, as long as there is room for it."""
    is_known = _HEARD.count(connection, {"by": sid, "now": now.timestamp()}) > 0
    if not is_known and _make_room(connection, host, now):
        connection.execute(insert(workers).values(sid=sid, host=host, slots=1, last_beat=now.timestamp()))


def _make_room(connection: Connection, host: str, now: datetime) -> bool:
    """Returns whether another session of a host can be recorded; forgets silent ones where that is needed."""
    before = now.timestamp() - _SILENT_S
    of_host, of_all = {"name": host}, dict[str, object]()
    for parameters, found, most in ((of_host, _OF_HOST, SESSIONS_OF_HOST), (of_all, _OF_ALL, SESSIONS)):
        row = found.first(connection, parameters)
        if row is None or row.known < most:
            continue
        if row.oldest >= before:
            return False
        of_whom = [workers.c.host == host] if parameters else []
        connection.execute(delete(workers).where(*of_whom, workers.c.last_beat < before))
    return True
