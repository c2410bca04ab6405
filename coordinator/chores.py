"""The chores of a coordinator: leases that expire, free space, barred hosts, the clock, the sandbox. Runs no thread."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import structlog

from coordinator.archive.contract import Archive
from coordinator.clock import ClockWatch
from coordinator.context import RunContext
from coordinator.lease_limit import LeaseLimit
from coordinator.ledger import claims
from coordinator.ledger.hosts import troubled
from coordinator.ledger.opening import note_sandbox
from coordinator.meters import Meter
from coordinator.periodic_tasks import PeriodicTask
from coordinator.validation.validator import sandbox_of

__all__ = ["RoomWatch", "RunChores"]

_BARRED_S = 5.0
_SANDBOX_S = 1.0
_ROOM_S = 1.0
_LEASE_LIMIT_S = 1.0
"""Pause between two looks for leases that are too old."""

log = structlog.get_logger(__name__)


class RoomWatch:
    """Watches the free space below which no job is given out.

    Args:
        reserve_bytes: that space.
    """

    def __init__(self, reserve_bytes: int) -> None:
        self._reserve_bytes = reserve_bytes
        self.has_room = True
        """Whether there was more at the last look."""

    def look(self, archive: Archive) -> None:
        """Looks again; a change is logged."""
        free = archive.free_bytes()
        has_room = free >= self._reserve_bytes
        if has_room == self.has_room:
            return
        self.has_room = has_room
        log.warning(
            "disk_has_room_again" if has_room else "disk_low_nothing_is_given_out",
            free_bytes=free,
            reserve_bytes=self._reserve_bytes,
            directory=str(archive.root),
            remedy="none" if has_room else "free some space; the run then continues",
        )


class RunChores:
    """What is to be done again and again while a run goes on.

    Args:
        run: shared parts of the coordinator.
        room: watches its free space.
        elapsed: seconds that pass evenly.
    """

    def __init__(self, run: RunContext, room: RoomWatch, elapsed: Callable[[], float]) -> None:
        self._run, self._room = run, room
        self._writer = run.ledger.writer
        self._watch = ClockWatch(run.clock, elapsed)
        self._limit = LeaseLimit(
            run.ledger.reading, self._writer.call, run.terms, run.clock, run.settings.lease_limit_s
        )
        self._barred: frozenset[str] = frozenset()
        self._noted_sandbox: tuple[str, ...] = ()

    def table(self, admit: Callable[[], bool]) -> Mapping[str, PeriodicTask]:
        """Returns every chore with its interval.

        Args:
            admit: applies changes of who is admitted; returns whether there were any.
        """
        settings = self._run.settings
        return {
            "expire": (settings.sweep_s, self._expire),
            "limit_leases": (_LEASE_LIMIT_S, self._limit_leases),
            "check_free_space": (_ROOM_S, self.check_free_space),
            "admit": (settings.admission_s, lambda: _admit(admit)),
            "note_sandbox": (_SANDBOX_S, self.note_sandbox),
            "warn_of_barred": (_BARRED_S, self._warn_of_barred),
        }

    def check_free_space(self) -> None:
        """Looks at the free space."""
        self._room.look(self._run.archive)

    def note_sandbox(self) -> None:
        """Records for `factory status` what confines the validating processes, once the first one has been started."""
        layers = sandbox_of(self._run.checker)
        if layers != self._noted_sandbox:
            self._writer.submit(lambda connection: note_sandbox(connection, layers))
            self._noted_sandbox = layers

    def _expire(self) -> None:
        self._check_clock()
        expired = self._writer.call(lambda connection: claims.expire(connection, self._run.clock()))
        if expired:
            self._run.meters.add(Meter.EXPIRED, expired)
            log.warning("leases_expired", jobs=expired, remedy="they are given to other workers")

    def _limit_leases(self) -> None:
        self._check_clock()
        if not self._room.has_room:
            self._limit.restart()  # no worker is to blame that its bundle waits
        self._run.meters.add(Meter.EXPIRED, self._limit.enforce())

    def _check_clock(self) -> None:
        """Starts all leases anew when the clock was set, for they end at times of the former one."""
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
            remedy = f"put it right, then `factory jobs release DIR {name}`"
            log.warning(
                "host_barred", host=name, failures=barred[name].strikes, last=barred[name].reason, remedy=remedy
            )
        self._barred = frozenset(barred)


def _admit(admit: Callable[[], bool]) -> None:
    if admit():
        log.warning("admission_changed", remedy="none; workers reconnect within seconds")
