"""Periodic tasks of a coordinator: expiry of leases, free space, barred hosts, clock, sandbox. Runs no thread.

A worker that keeps a job too long loses it even if its heartbeats arrive: the job returns to the queue, and the host
gets a strike.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from datetime import datetime
from typing import Any

import structlog
from sqlalchemy.engine import Connection

from coordinator.archive.contract import Archive
from coordinator.clock import ClockWatch
from coordinator.context import RunContext
from coordinator.ledger import claims
from coordinator.ledger.claims import held_too_long, lease_of
from coordinator.ledger.hosts import troubled, write_memory
from coordinator.ledger.opening import note_sandbox
from coordinator.ledger.reading.progress import count_attempts
from coordinator.ledger.transitions import JobRow
from coordinator.meters import Meter
from coordinator.periodic_tasks import PeriodicTask
from coordinator.protocol.protocol import Terms, fail_attempt
from coordinator.validation.validator import sandbox_of
from schemas.errors import WorldError
from schemas.job import episode_id
from schemas.protocol.keys import host_of
from schemas.protocol.messages import Fail, HostMemory
from schemas.terms import FailReason

_SHOWN_HOSTS = 10
_BARRED_S = 5.0
_SANDBOX_S = 1.0
_VIEW_S = 2.0
_MIN_BLIND_ATTEMPTS = 20
"""Number of attempts without a view from which on the run may end."""
_ROOM_S = 1.0
_MEMORY_S = 5.0
_LEASE_LIMIT_S = 1.0
"""Pause between two checks of the lease limit, seconds."""

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
        """Ends no lease for the next `limit_s` seconds.

        Called after a start, after the clock was set, and while the disk is full.
        """
        self._since = self._clock()

    def enforce(self) -> int:
        """Ends the leases that exceed the limit; returns their number."""
        now = self._clock()
        if (now - self._since).total_seconds() < self._limit_s:
            return 0
        with self._reading() as connection:
            expired = held_too_long(connection, now, self._limit_s)
        if not expired:
            return 0
        ended = self._commit(lambda connection: [row for row in expired if self._end(connection, row, now)])
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


class FreeSpaceMonitor:
    """Checks whether enough space is free; if not, no job is leased.

    Args:
        reserve_bytes: the minimum free space, bytes.
    """

    def __init__(self, reserve_bytes: int) -> None:
        self._reserve_bytes = reserve_bytes
        self.has_room = True
        """Whether at least the reserve was free at the last check."""

    def look(self, archive: Archive) -> None:
        """Checks the free space; logs a change."""
        free = archive.free_bytes()
        has_room = free >= self._reserve_bytes
        if has_room == self.has_room:
            return
        self.has_room = has_room
        log.warning(
            "disk_space_recovered" if has_room else "disk_low_no_jobs_leased",
            free_bytes=free,
            reserve_bytes=self._reserve_bytes,
            directory=str(archive.root),
            remedy="none" if has_room else "free some space; the run then continues",
        )


class Housekeeping:
    """Tasks that are repeated until the end of a run.

    Args:
        run: shared parts of the coordinator.
        room: monitor of the free space for archived episodes.
        elapsed: monotonic clock, seconds.
    """

    def __init__(self, run: RunContext, room: FreeSpaceMonitor, elapsed: Callable[[], float]) -> None:
        self._run, self._room = run, room
        self._writer = run.ledger.writer
        self._watch = ClockWatch(run.clock, elapsed)
        self._limit = LeaseLimit(
            run.ledger.reading, self._writer.call, terms=run.terms, clock=run.clock, limit_s=run.settings.lease_limit_s
        )
        self._barred: frozenset[str] = frozenset()
        self._noted_sandbox: tuple[str, ...] = ()
        self._recorded_memory: dict[str, HostMemory] = {}
        self._tried_before: Mapping[str, int] | None = None
        self._blind = ""

    def table(self, admit: Callable[[], bool]) -> Mapping[str, PeriodicTask]:
        """Returns every task with its interval.

        Args:
            admit: applies changes of the admission list; returns whether there were any.
        """
        settings = self._run.settings
        return {
            "expire": (settings.sweep_s, self._expire),
            "limit_leases": (_LEASE_LIMIT_S, self._limit_leases),
            "check_free_space": (_ROOM_S, self.check_free_space),
            "admit": (settings.admission_s, lambda: _admit(admit)),
            "note_sandbox": (_SANDBOX_S, self.note_sandbox),
            "record_memory": (_MEMORY_S, self.record_memory),
            "warn_of_barred": (_BARRED_S, self._warn_of_barred),
            "check_views": (_VIEW_S, self.check_views),
        }

    def check_free_space(self) -> None:
        self._room.look(self._run.archive)

    def note_sandbox(self) -> None:
        """Records the sandbox layers of the validating processes for `factory status`, once a process was started."""
        layers = sandbox_of(self._run.checker)
        if layers != self._noted_sandbox:
            self._writer.submit(lambda connection: note_sandbox(connection, layers))
            self._noted_sandbox = layers

    def record_memory(self) -> None:
        """Records the memory of the hosts for the web page, if a heartbeat has changed it."""
        memory = dict(self._run.terms.memory)
        if memory != self._recorded_memory:
            self._writer.submit(lambda connection: write_memory(connection, memory))
            self._recorded_memory = memory

    def check_views(self) -> None:
        """Notes whether most attempts since the start of the coordinator failed because the camera shows nothing."""
        with self._run.ledger.reading() as connection:
            tried = count_attempts(connection)
        if self._tried_before is None:
            self._tried_before = tried
        new = {outcome: count - self._tried_before.get(outcome, 0) for outcome, count in tried.items()}
        blind, attempts = new.get(FailReason.NO_VIEW, 0), sum(new.values())
        if blind >= _MIN_BLIND_ATTEMPTS and 2 * blind > attempts:
            self._blind = (
                f"{blind} of {attempts} attempts failed because the camera shows nothing: the start view is one flat "
                "surface, or the expert never saw its target. Check `[camera]` (field of view in degrees, height and "
                "pitch) and the scene with `factory scene render`, correct the plan, and start in a new folder; "
                "archived episodes are kept, and the same command continues with the plan as it is"
            )

    def require_view(self) -> None:
        """Raises `WorldError` if the camera of most attempts shows nothing, because the dataset would be useless."""
        if self._blind:
            raise WorldError(self._blind)

    def _expire(self) -> None:
        self._check_clock()
        expired = self._writer.call(lambda connection: claims.expire(connection, self._run.clock()))
        if expired:
            self._run.meters.add(Meter.EXPIRED, expired)
            log.warning("leases_expired", jobs=expired, remedy="they are given to other workers")

    def _limit_leases(self) -> None:
        self._check_clock()
        if not self._room.has_room:
            self._limit.restart()  # the bundles of the leases wait for space, which is not a fault of the workers
        self._run.meters.add(Meter.EXPIRED, self._limit.enforce())

    def _check_clock(self) -> None:
        """Restarts all leases if the wall clock was set, because their end times refer to the previous clock."""
        jump_s = self._watch.jump_s()
        if jump_s:
            run = self._run
            held = self._writer.call(
                lambda connection: claims.grant_grace(connection, run.clock(), run.settings.lease_ttl_s)
            )
            self._watch.accept()
            self._limit.restart()
            log.warning("clock_was_set", by_s=round(jump_s), leases=held, remedy="none; all leases restart")

    def _warn_of_barred(self) -> None:
        with self._run.ledger.reading() as connection:
            barred = {host.host: host for host in troubled(connection) if host.barred_at is not None}
        for name in sorted(barred.keys() - self._barred):
            remedy = f"repair the host, then run `factory jobs release DIR {name}`"
            log.warning(
                "host_barred", host=name, failures=barred[name].strikes, last=barred[name].reason, remedy=remedy
            )
        self._barred = frozenset(barred)


def _admit(admit: Callable[[], bool]) -> None:
    # reads the list of hosts again during the run, because a restart of the coordinator would interrupt all workers
    if admit():
        log.warning("admission_changed", remedy="none; workers reconnect within seconds")
