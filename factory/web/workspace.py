"""Reads the dataset of a web page and the state of its run; keeps the table of episodes current. Serves nothing.

A large table takes seconds to read, so changed files are read in the background and the old table is returned
meanwhile. All columns are read at once, because with columns on demand, each first sorting or filter was slow.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from coordinator.archive.staging import is_held
from coordinator.ledger.builds import unbuilt_layouts
from coordinator.ledger.database.engine import sqlite_files
from coordinator.ledger.opening import LedgerInfo, ledger_url_of, read_info, recorded_ledger
from coordinator.ledger.reading.failures import FailedPlace, count_failures, read_failures
from coordinator.ledger.reading.farm import FarmReading, read_farm
from factory.dataset.packages import packages_by_scene
from factory.dataset.reader import Dataset
from factory.dataset.site import Site
from factory.runs.ledger import progress_in, read_ledger
from factory.support.text import format_bytes
from factory.web.live import pause_after
from factory.web.table import EpisodeTable
from schemas.dataset.meta import DatasetMeta, read_dataset_meta
from schemas.errors import FactoryError, WorldError
from schemas.protocol.status import Progress
from schemas.storage.dataset_files import META_FILE, METADATA_FILE, SCENES
from schemas.storage.place import Place

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
        table = self.get_within(None)
        assert table is not None
        return table

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


_RECHECK_S = 1.0
_REMOTE_RECHECK_S = 60.0
"""Pause between two checks for new tables in object storage, seconds; `_RECHECK_S` is the pause for a directory."""


class Farm(NamedTuple):
    """State of a run at one time."""

    progress: Progress
    """Progress of the run."""
    reading: FarmReading
    """Cells, running jobs, events and recent attempts."""
    at: datetime
    """Time of the reading, UTC."""
    info: LedgerInfo
    """Description of the run."""
    failed: Mapping[str, int]
    """Number of recent failed attempts by scene."""


class SceneList(NamedTuple):
    """Scenes of a dataset."""

    packages: Mapping[str, str]
    """SHA-256 of the package by name of the scene."""
    unbuilt: tuple[str, ...] = ()
    """Planned layouts without a package."""


class Workspace:
    """Thread-safe access to a dataset and its run, for all pages of one server.

    Args:
        site: location of the dataset.
        ledger: URL of the ledger; `None` for the ledger of the dataset.
        base: prefix of the paths of the dataset's pages; empty if the server has no other dataset.
    """

    def __init__(self, site: Site, ledger: str | None = None, base: str = "") -> None:
        self.site = site
        """Location of the dataset."""
        self.ledger = ledger
        """URL of the ledger; `None` for the ledger of the dataset."""
        self.base = base
        """Prefix of the paths of the dataset's pages; empty if the server has no other dataset."""
        self._listing = threading.Lock()
        self._listed = -float("inf")
        self._packaged: frozenset[str] = frozenset()
        self._pause_s = _RECHECK_S if site.store is None else _REMOTE_RECHECK_S
        self._table = CurrentTable(self._read_dataset, self._version_of_tables, self._pause_s)

    @property
    def root(self) -> Place:
        return self.site.place

    def table(self) -> EpisodeTable:
        """Returns the table of the episodes as its files are now, or as they were shortly before.

        Raises:
            FactoryError: the tables are missing or damaged.
        """
        return self._table.get()

    def table_within(self, seconds: float) -> EpisodeTable | None:
        """Returns the table, or `None` if the first one is not read within a time; raises the errors of `table`."""
        return self._table.get_within(seconds)

    def dataset(self) -> Dataset:
        """Returns the dataset of `table`; raises the same errors."""
        return self.table().dataset

    def meta(self) -> DatasetMeta | None:
        """Returns the description of the dataset; `None` if it has none yet."""
        try:
            return read_dataset_meta(self.root)
        except FactoryError:
            return None

    def scenes(self) -> SceneList:
        """Returns the scenes of the dataset, including layouts that were built after its description was written."""
        meta = self.meta()
        described = meta.scenes if meta else {}
        try:
            with read_ledger(self.site, self.ledger) as connection:
                info = read_info(connection)
        except FactoryError:
            return SceneList(described)
        packages = {**info.scenes, **described, **info.layouts}
        return SceneList(packages, tuple(unbuilt_layouts(info.plan, packages)))

    def farm(self) -> Farm:
        """Returns the state of the run.

        Raises:
            FactoryError: the dataset has no ledger, or a damaged one.
        """
        now = datetime.now(UTC)
        with read_ledger(self.site, self.ledger) as connection:
            progress = progress_in(connection, self.site, self.ledger)
            reading = read_farm(connection, now)
            return Farm(progress, reading, at=now, info=read_info(connection), failed=count_failures(connection))

    def failures(self, scene: str) -> list[FailedPlace]:
        """Returns the newest failed attempts of a scene; empty without a ledger."""
        try:
            with read_ledger(self.site, self.ledger) as connection:
                return read_failures(connection, scene)
        except FactoryError:
            return []

    def packaged_scenes(self) -> frozenset[str]:
        """Returns the names of the scenes whose package is stored in the dataset."""
        with self._listing:
            if time.monotonic() - self._listed > self._pause_s:
                self._packaged, self._listed = frozenset(packages_by_scene(self.root / SCENES)), time.monotonic()
            return self._packaged

    def is_written(self) -> bool:
        """Returns whether a coordinator on this machine adds episodes to the dataset."""
        return bool(is_held(self.site.state_dir))

    def ledger_health(self) -> str:
        """Returns kind and size of the ledger, and whether a coordinator writes to it."""
        elsewhere = self.ledger or recorded_ledger(self.site.state_dir)
        if elsewhere:
            return f"{elsewhere.partition('://')[0]} database"
        sizes = [path.stat().st_size for path in sqlite_files(ledger_url_of(self.site.state_dir)) if path.exists()]
        writer = "a coordinator writes to it" if self.is_written() else "no coordinator writes to it"
        return f"{format_bytes(sum(sizes))}, {writer}"

    def _read_dataset(self) -> Dataset:
        try:
            return Dataset(self.site.place)
        except WorldError as error:
            if (run := self._run_without_tables()) is None:
                raise
            raise WorldError(
                f"run {run} has no tables of episodes yet: its coordinator writes them soon after the first archived "
                "episode; then load this page again"
            ) from error

    def _run_without_tables(self) -> str | None:
        """Returns the name of the run if it has a ledger, but no description of its dataset yet."""
        if (self.root / META_FILE).is_file():
            return None
        try:
            with read_ledger(self.site, self.ledger) as connection:
                return read_info(connection).plan.run
        except FactoryError:
            return None

    def _version_of_tables(self) -> object:
        if self.site.store is not None:
            return None
        return tuple(_stamp(self.site.state_dir / name) for name in (METADATA_FILE, META_FILE))


def _stamp(path: Path) -> tuple[int, int, int] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_ino, status.st_mtime_ns, status.st_size
