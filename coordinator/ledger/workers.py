"""Records the workers of a run and their signs of life, for a bounded number of sessions. Does not change jobs."""

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
"""Maximum number of recorded sessions, in total and per host: twice the maximum number of connections."""
_SILENT_S = 300.0
"""Time without a message after which a session may be removed in favour of a new one, seconds."""

_OLDEST = func.min(workers.c.last_beat).label("oldest")
_KNOWN: Any = select(func.count().label("known"), _OLDEST).select_from(workers)
_OF_ALL = PreparedStatement(_KNOWN)
_OF_HOST = PreparedStatement(_KNOWN.where(workers.c.host == bindparam("name")))
_HEARD = PreparedStatement(update(workers).where(workers.c.sid == bindparam("by")).values(last_beat=bindparam("now")))


def register(connection: Connection, hello: Hello, now: datetime) -> bool:
    """Records or updates a worker; returns `False` if the maximum number of sessions is reached."""
    values = {"host": hello.host, "slots": hello.slots, "version": hello.version, "last_beat": now.timestamp()}
    if connection.execute(update(workers).where(workers.c.sid == hello.sid).values(values)).rowcount:
        return True
    if not _make_room(connection, hello.host, now):
        return False
    connection.execute(insert(workers).values(sid=hello.sid, **values))
    return True


def note_alive(connection: Connection, sid: str, host: str, now: datetime) -> None:
    """Records the time of a message of a worker, registered or not, within the maximum number of sessions."""
    is_known = _HEARD.count(connection, {"by": sid, "now": now.timestamp()}) > 0
    if not is_known and _make_room(connection, host, now):
        connection.execute(insert(workers).values(sid=sid, host=host, slots=1, last_beat=now.timestamp()))


def _make_room(connection: Connection, host: str, now: datetime) -> bool:
    """Removes silent sessions if necessary; returns whether another session of a host can be recorded."""
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
