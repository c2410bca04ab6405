"""Limits how long one worker holds a job, however regularly it beats. Decides nothing about silent workers.

A job that is held longer returns to the queue, and the failure counts against the host.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from datetime import datetime
from typing import Any

import structlog
from sqlalchemy.engine import Connection

from coordinator.ledger.claims import held_too_long, lease_of
from coordinator.ledger.moves import JobRow
from coordinator.protocol.protocol import Terms, fail_attempt
from schemas.job import episode_id
from schemas.keys import host_of
from schemas.terms import FailReason
from schemas.wire import Fail

__all__ = ["LeaseLimit"]

_SHOWN_HOSTS = 10
log = structlog.get_logger(__name__)


class LeaseLimit:
    """Ends leases that are older than the limit.

    Args:
        reading: opens the ledger for reading.
        commit: runs work on the ledger in one commit and returns its result.
        terms: of the run.
        clock: the time.
        limit_s: longest time from claim to archived episode, seconds.
    """

    def __init__(
        self,
        reading: Callable[[], AbstractContextManager[Connection]],
        commit: Callable[[Callable[[Connection], Any]], Any],
        terms: Terms,
        clock: Callable[[], datetime],
        limit_s: float,
    ) -> None:
        self._reading, self._commit, self._terms, self._clock = reading, commit, terms, clock
        self._limit_s = limit_s
        self.restart()

    def restart(self) -> None:
        """Gives all leases the whole limit again: after a start, when the clock was set, and while no bundle fits."""
        self._since = self._clock()

    def enforce(self) -> int:
        """Ends the leases that are too old now; returns how many."""
        now = self._clock()
        if (now - self._since).total_seconds() < self._limit_s:
            return 0
        with self._reading() as connection:
            found = held_too_long(connection, now, self._limit_s)
        if not found:
            return 0
        ended = self._commit(lambda connection: [row for row in found if self._end(connection, row, now)])
        if ended:
            _tell(ended)
        return len(ended)

    def _end(self, connection: Connection, row: JobRow, now: datetime) -> bool:
        detail = f"no episode after {self._limit_s:.0f} s under one lease; the job is {row.state}"
        report = Fail(sid=row.sid, lease=lease_of(row), reason=FailReason.HANG, detail=detail, steps=row.step)
        return fail_attempt(connection, report, self._terms, now)


def _tell(ended: Sequence[JobRow]) -> None:
    log.warning(
        "leases_too_long",
        jobs=len(ended),
        first=episode_id(ended[0].idx),
        hosts=sorted({host_of(row.sid) for row in ended})[:_SHOWN_HOSTS],
        remedy="the jobs are given to other workers; see `factory status` for the hosts",
    )
