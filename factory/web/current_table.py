"""Keeps the table of the episodes current: reads changed files in the background and meanwhile returns the old table.

A large table takes seconds to read, and a page must not wait for it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future

from factory.dataset.reader import Dataset
from factory.web.live import pause_after
from factory.web.table import EpisodeTable

_PATIENCE_S = 0.1
"""Maximum time that a request waits for changed files to be read, seconds; after it, the request gets the old table."""


class CurrentTable:
    """Table of a dataset as its files are now, or as they were shortly before; thread-safe.

    Args:
        read: function that reads the dataset.
        version: function that returns a value that changes with the files; `None` if that is unknown.
        pause_s: minimum time between two checks, seconds. Each time the files are read, the next pause is longer by
            fifty times the CPU time of the reading.
        clock: function that returns the time, seconds.
    """

    def __init__(
        self,
        read: Callable[[], Dataset],
        version: Callable[[], object],
        pause_s: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._read_dataset, self._version_of, self._pause_s, self._clock = read, version, pause_s, clock
        self._lock = threading.Lock()
        self._table: EpisodeTable | None = None
        self._version: object = None
        self._reading: Future[EpisodeTable] | None = None
        self._next_check_s = -float("inf")

    def get(self) -> EpisodeTable:
        """Returns the table; equal files give the same object.

        Raises:
            FactoryError: the files are missing or damaged.
        """
        found = self.get_within(None)
        assert found is not None
        return found

    def get_within(self, seconds: float | None) -> EpisodeTable | None:
        """Returns the table like `get`; `None` if the first table is not read within `seconds`.

        `seconds=None` waits without limit.
        """
        with self._lock:
            if self._reading is None and (self._table is None or self._clock() > self._next_check_s):
                self._check()
            table, reading = self._table, self._reading
        if table is not None and reading is not None:
            try:
                return reading.result(_PATIENCE_S)
            except TimeoutError:
                return table
        if reading is None:
            return table
        try:
            return reading.result(seconds)
        except TimeoutError:
            return None

    def _check(self) -> None:
        """Starts to read the files if they have changed; the caller holds the lock."""
        version = self._version_of()
        self._next_check_s = self._clock() + self._pause_s
        if self._table is None or version is None or version != self._version:
            self._reading = Future()
            threading.Thread(target=self._read, args=(version, self._reading), name="table", daemon=True).start()

    def _read(self, version: object, reading: Future[EpisodeTable]) -> None:
        begin_s = time.thread_time()
        try:
            table = EpisodeTable(self._read_dataset())
            table.load()
        except Exception as error:  # noqa: BLE001 - raised by the future
            self._keep(None, None)
            reading.set_exception(error)
            return
        self._keep(table, version)
        reading.set_result(table)
        table.sort_all()
        with self._lock:
            self._next_check_s += pause_after(time.thread_time() - begin_s, 0.0)

    def _keep(self, table: EpisodeTable | None, version: object) -> None:
        with self._lock:
            self._table, self._version, self._reading = table, version, None
