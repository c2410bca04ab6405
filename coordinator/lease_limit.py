"""Limits the time that one worker holds a job, even if its heartbeats arrive. Does not expire silent leases.

A job that is held longer returns to the queue, and the host gets a strike.
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
    """Limit of the age of leases.

    Args:
        reading: function that opens the ledger for reading.
        commit: function that runs work on the ledger in one commit and returns the result.
        terms: terms of the run.
        clock: wall clock.
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
        """Restarts the limit of all leases: after a start, after the clock was set, and while the disk is full."""
        self._since = self._clock()

    def enforce(self) -> int:
        """Ends the leases that exceed the limit; returns their number."""
        now = self._clock()
        if (now - self._since).total_seconds() < self._limit_s:
            return 0
        with self._reading() as connection:
            found = held_too_long(connection, now, self._limit_s)
        if not found:
            return 0
        ended = self._commit(lambda connection: [row for row in found if self._end(connection, row, now)])
        if ended:
            _log_ended(ended)
        return len(ended)

    def _end(self, connection: Connection, row: JobRow, now: datetime) -> bool:
        detail = f"no episode after {self._limit_s:.0f} s under one lease; the job is {row.state}"
        report = Fail(sid=row.sid, lease=lease_of(row), reason=FailReason.HANG, detail=detail, steps=row.step)
        return fail_attempt(connection, report, self._terms, now)


def _log_ended(ended: Sequence[JobRow]) -> None:
    log.warning(
        "lease_limit_exceeded",
        jobs=len(ended),
        first=episode_id(ended[0].idx),
        hosts=sorted({host_of(row.sid) for row in ended})[:_SHOWN_HOSTS],
        remedy="the jobs are given to other workers; see `factory status` for the hosts",
    )
