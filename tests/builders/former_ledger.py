"""Turns a ledger into one of an older format. Later software cannot open it."""

from __future__ import annotations

from sqlalchemy import text, update
from sqlalchemy.engine import Connection

from coordinator.ledger.tables import events, info

_FORMER_EVENTS = {"task_failed": "missed", "worker_failed": "hurt"}
_TRIGGERS = ("jobs_insert", "jobs_update", "attempts_insert", "attempts_update")
_NOT_IN_FORMAT_1 = ("keepers", "hosts", "unchecked_episodes", "job_tallies", "attempt_tallies")


def make_former(connection: Connection, form: int) -> None:
    """Gives a ledger on SQLite the format number, the names of events and, for format 1, the tables of that format."""
    connection.execute(update(info).where(info.c.key == "format").values(value=str(form)))
    for name, former in _FORMER_EVENTS.items():
        connection.execute(update(events).where(events.c.event == name).values(event=former))
    if form == 1:
        for name in _TRIGGERS:
            connection.execute(text(f"DROP TRIGGER count_{name}"))
        for name in _NOT_IN_FORMAT_1:
            connection.execute(text(f"DROP TABLE {name}"))
