"""Who works for the run: introductions and signs of life of workers. Touches no job."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import bindparam, insert, update
from sqlalchemy.engine import Connection

from coordinator.ledger.prepared import Prepared
from coordinator.ledger.tables import workers
from schemas.wire import Hello

__all__ = ["introduce", "note_alive"]

_HEARD = Prepared(update(workers).where(workers.c.sid == bindparam("by")).values(last_beat=bindparam("now")))


def introduce(connection: Connection, hello: Hello, now: datetime) -> None:
    """Records a worker, or what it says of itself now."""
    values = {"host": hello.host, "slots": hello.slots, "version": hello.version, "last_beat": now.timestamp()}
    if connection.execute(update(workers).where(workers.c.sid == hello.sid).values(values)).rowcount == 0:
        connection.execute(insert(workers).values(sid=hello.sid, **values))


def note_alive(connection: Connection, sid: str, host: str, now: datetime) -> None:
    """Records that a worker was heard of, introduced or not."""
    if _HEARD.count(connection, {"by": sid, "now": now.timestamp()}) == 0:
        connection.execute(insert(workers).values(sid=sid, host=host, slots=1, last_beat=now.timestamp()))
