"""Reads the jobs that a Slurm task has leased, and how their leases end when the task is stopped, from the ledger."""

from __future__ import annotations

import sqlite3
from collections import Counter
from contextlib import closing
from pathlib import Path
from typing import Any

from coordinator.ledger.states import Event

FALSE_ENDS = frozenset({Event.WORKER_FAILED, Event.QUARANTINED, Event.LOST})
"""Ledger events that count against a host or a job. Stopping a Slurm task must not cause any of them."""
_OF_SESSION = "(:session IS NULL OR sid = :session)"


def held(dataset: Path, session: str | None = None) -> set[tuple[int, int]]:
    """Returns job ID and fence of each leased job; `session` limits the result to one worker."""
    query = f"SELECT id, fence FROM jobs WHERE state = 'leased' AND {_OF_SESSION}"
    return {(job, fence) for job, fence in _read(dataset, query, session=session)}


def ends(dataset: Path, since: float, session: str | None = None) -> Counter[str]:
    """Returns the number of job events by kind since a time (Unix seconds); `session` limits them to one worker."""
    query = f"SELECT event FROM events WHERE at >= :since AND {_OF_SESSION}"
    return Counter(kind for (kind,) in _read(dataset, query, session=session, since=since))


def waiting(dataset: Path) -> int:
    """Returns the number of jobs in the queue."""
    ((number,),) = _read(dataset, "SELECT count(*) FROM jobs WHERE state = 'pending'") or [(0,)]
    return int(number)


def _read(dataset: Path, query: str, **values: str | float | None) -> list[tuple[Any, ...]]:
    ledger = dataset / "ledger.db"
    if not ledger.exists():
        return []
    with closing(sqlite3.connect(f"file:{ledger}?mode=ro", uri=True)) as opened:
        try:
            return opened.execute(query, values).fetchall()
        except sqlite3.OperationalError:  # a coordinator is creating the ledger
            return []
