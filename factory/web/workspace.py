"""Opens the dataset of a web page again when its tables change, and reads the state of its run. Serves nothing."""

from __future__ import annotations

import threading
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from coordinator.ledger.reading.farm import FarmReading, read_farm
from factory.dataset.reader import Dataset
from factory.dataset.site import Site
from factory.runs.ledger import progress_of, read_ledger
from schemas.dataset.meta import DatasetMeta, read_dataset_meta
from schemas.errors import FactoryError
from schemas.protocol.status import Progress
from schemas.storage.dataset_files import META_FILE, METADATA_FILE
from schemas.storage.place import Place

_RECHECK_S = 1.0
_REMOTE_RECHECK_S = 60.0
"""Pauses between two checks for new tables, in a directory and in object storage, seconds."""


class Farm(NamedTuple):
    """State of a run at one time."""

    progress: Progress
    """Progress of the run."""
    reading: FarmReading
    """Cells, running jobs, events and recent attempts."""
    at: datetime
    """Time of the reading, UTC."""


class Workspace:
    """Thread-safe access to a dataset and its run, for all pages of one server.

    Args:
        site: location of the dataset.
        ledger: URL of the ledger; `None` for the ledger of the dataset.
    """

    def __init__(self, site: Site, ledger: str | None = None) -> None:
        self.site = site
        """Location of the dataset."""
        self.ledger = ledger
        """URL of the ledger; `None` for the ledger of the dataset."""
        self._opening = threading.Lock()
        self._dataset: Dataset | None = None
        self._version: object = None
        self._checked = -float("inf")

    @property
    def root(self) -> Place:
        """Location of the dataset's files."""
        return self.site.place

    def dataset(self) -> Dataset:
        """Returns the dataset as its tables are now; equal tables give the same object.

        Raises:
            FactoryError: the tables are missing or damaged.
        """
        pause_s = _RECHECK_S if self.site.store is None else _REMOTE_RECHECK_S
        with self._opening:
            if self._dataset is None or time.monotonic() - self._checked > pause_s:
                version = self._version_of_tables()
                if self._dataset is None or version is None or version != self._version:
                    self._dataset = Dataset(self.root)
                self._version, self._checked = version, time.monotonic()
            return self._dataset

    def meta(self) -> DatasetMeta | None:
        """Returns the description of the dataset; `None` if it has none yet."""
        try:
            return read_dataset_meta(self.root)
        except FactoryError:
            return None

    def farm(self) -> Farm:
        """Returns the state of the run.

        Raises:
            FactoryError: the dataset has no ledger, or a damaged one.
        """
        now = datetime.now(UTC)
        progress = progress_of(self.site, self.ledger)
        with read_ledger(self.site, self.ledger) as connection:
            return Farm(progress, read_farm(connection, now), now)

    def _version_of_tables(self) -> object:
        if self.site.store is not None:
            return None
        return tuple(_stamp(self.site.home / name) for name in (METADATA_FILE, META_FILE))


def _stamp(path: Path) -> tuple[int, int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns, found.st_size
