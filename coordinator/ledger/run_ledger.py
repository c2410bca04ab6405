"""Ledger of a running coordinator: one engine for writing, another for reading. Does not change jobs."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from datetime import datetime

import structlog

from coordinator.ledger import claims
from coordinator.ledger.database.engine import open_reader, open_writer, share_finished, shown_url, write_closed_digest
from coordinator.ledger.database.writer import Writer
from coordinator.ledger.reading.progress import count_frames, read_progress
from coordinator.ledger.reading.reader import Connection, open_ledger, translate_damage
from schemas.errors import TransientError, WorldError
from schemas.protocol.status import Progress
from schemas.support.closing import Closing
from schemas.support.log_limit import Repeated

log = structlog.get_logger(__name__)
RESTART_REMEDY = "start again: the ledger is rebuilt from the episodes"


class RunLedger(Closing):
    """Open ledger of one run.

    Args:
        url: URL of the database.
        run: name of the run.
        clock: wall clock.
        outage_s: longest time for which a database server may not answer, seconds.
    """

    def __init__(self, url: str, run: str, clock: Callable[[], datetime], outage_s: float) -> None:
        self._url, self._run, self._clock = url, run, clock
        self._outage = _Outage(shown_url(url), outage_s)
        self._last: tuple[Progress, int] | None = None
        self._is_usable = False
        with ExitStack() as stack:
            self.engine = open_writer(url)
            """Engine for writing; used directly only before `start_writer`."""
            stack.callback(self.engine.dispose)
            self._reader = open_reader(url)
            stack.callback(self._reader.dispose)
            self._stack = stack.pop_all()

    def start_writer(self) -> None:
        """Starts `writer`, the thread that does all further writing."""
        self.writer = self._stack.enter_context(Writer(self.engine))
        """Writer thread, which commits in groups."""
        self._is_usable = True

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """Yields a reading connection.

        Raises:
            WorldError: the ledger was damaged or removed meanwhile.
            TransientError: the server of the ledger does not answer.
        """
        if self.writer.damage:
            raise WorldError(f"the ledger of run {self._run} is damaged: {self.writer.damage}; {RESTART_REMEDY}")
        try:
            with translate_damage(self._url), self._reader.connect() as connection:
                yield connection
        except WorldError:
            self._is_usable = False
            raise

    def progress(self) -> Progress:
        """Returns the progress of the run; while the server of the ledger does not answer, the last known progress.

        Raises:
            WorldError: the ledger is damaged, or its server has not answered for `outage_s`.
            TransientError: the server does not answer, and no progress is known yet.
        """
        return self.figures()[0]

    def figures(self) -> tuple[Progress, int]:
        """Returns the progress of the run and the number of archived frames; see `progress`."""
        try:
            with self.reading() as connection:
                self._last = read_progress(connection, self._clock()), count_frames(connection)
            self._outage.end()
        except TransientError as error:
            self._outage.note(error)
            if self._last is None:
                raise
        return self._last

    def is_finished(self) -> bool:
        """Returns whether no job can change any more without an admin request; false while the server is away.

        Raises:
            WorldError: the ledger is damaged, or its server has not answered for `outage_s`.
        """
        try:
            with self.reading() as connection:
                has_open_jobs = claims.has_open_jobs(connection)
        except TransientError as error:
            self._outage.note(error)
            return False
        self._outage.end()
        return not has_open_jobs

    def close(self) -> None:
        """Commits the queued work, closes the database, and writes its digest if no damage was found."""
        self._stack.close()
        if self._is_usable and not self.writer.damage:
            write_closed_digest(self._url)
            self._share_if_finished()

    def _share_if_finished(self) -> None:
        with contextlib.suppress(WorldError, TransientError), open_ledger(self._url) as connection:
            if not claims.has_open_jobs(connection):
                share_finished(self._url)


class _Outage:
    """Time for which the server of a ledger has not answered. Readers repeat their reads until it is too long."""

    def __init__(self, ledger: str, limit_s: float) -> None:
        self._ledger, self._limit_s = ledger, limit_s
        self._guard = threading.Lock()
        self._since: float | None = None
        self._log = Repeated(log, "ledger_unreachable")

    def note(self, error: TransientError) -> None:
        """Counts a read without an answer.

        Raises:
            WorldError: the server has not answered for too long.
        """
        with self._guard:
            now = time.monotonic()
            self._since = now if self._since is None else self._since
            silence_s = now - self._since
        self._log.fail(error, remedy=f"start the server; the run continues, for at most {self._limit_s:g} s without it")
        if silence_s > self._limit_s:
            raise WorldError(
                f"the server of the ledger {self._ledger} has not answered for {silence_s:.0f} s: start it, then start "
                "the coordinator again with the same command; no episode is lost"
            ) from error

    def end(self) -> None:
        """Notes an answer."""
        with self._guard:
            self._since = None
        self._log.succeed()
