"""Who works for the run: introductions and signs of life of workers, a bounded number of them. Touches no job."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import bindparam, delete, func, insert, select, update
from sqlalchemy.engine import Connection

from coordinator.ledger.prepared import Prepared
from coordinator.ledger.tables import workers
from schemas.wire import Hello

__all__ = ["SESSIONS", "SESSIONS_OF_HOST", "introduce", "note_alive"]

SESSIONS, SESSIONS_OF_HOST = 10_000, 2000
"""Most sessions that are known, in all and of one host: twice as many as can be connected."""
_SILENT_S = 300.0
"""Silence after which a session is forgotten where there is no room for another."""

_HEARD = Prepared(update(workers).where(workers.c.sid == bindparam("by")).values(last_beat=bindparam("now")))


def introduce(connection: Connection, hello: Hello, now: datetime) -> bool:
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
    theirs = workers.c.host == host
    for which, most in ((theirs, SESSIONS_OF_HOST), (workers.c.sid.is_not(None), SESSIONS)):
        count = select(func.count()).select_from(workers).where(which)
        if connection.execute(count).scalar_one() < most:
            continue
        silent = workers.c.last_beat < now.timestamp() - _SILENT_S
        if connection.execute(delete(workers).where(which, silent)).rowcount == 0:
            return False
    return True
