"""Ledger of a running coordinator: one engine for writing, another for reading. Does not change jobs."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from datetime import datetime

from coordinator.ledger import claims
from coordinator.ledger.database.engine import open_reader, open_writer, share_finished, write_closed_digest
from coordinator.ledger.database.writer import Writer
from coordinator.ledger.reading.progress import count_frames, read_progress
from coordinator.ledger.reading.reader import Connection, open_ledger, translate_damage
from schemas.errors import WorldError
from schemas.protocol.status import Progress
from schemas.support.closing import Closing

RESTART_REMEDY = "start again: the ledger is rebuilt from the episodes"


class RunLedger(Closing):
    """Open ledger of one run.

    Args:
        url: URL of the database.
        run: name of the run.
        clock: wall clock.
    """

    def __init__(self, url: str, run: str, clock: Callable[[], datetime]) -> None:
        self._url, self._run, self._clock = url, run, clock
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
        with self.reading() as connection:
            return read_progress(connection, self._clock())

    def figures(self) -> tuple[Progress, int]:
        """Returns the progress of the run and the number of archived frames."""
        with self.reading() as connection:
            return read_progress(connection, self._clock()), count_frames(connection)

    def is_finished(self) -> bool:
        """Returns whether no job can change any more without an admin request."""
        with self.reading() as connection:
            return not claims.has_open_jobs(connection)

    def close(self) -> None:
        """Commits the queued work, closes the database, and writes its digest if no damage was found."""
        self._stack.close()
        if self._is_usable and not self.writer.damage:
            write_closed_digest(self._url)
            self._share_if_finished()

    def _share_if_finished(self) -> None:
        with contextlib.suppress(WorldError), open_ledger(self._url) as connection:
            if not claims.has_open_jobs(connection):
                share_finished(self._url)
