"""Finds the datasets of a folder, describes each of them for their list, and opens those whose pages are requested.

A dataset is a direct subdirectory. Its name in a URL is compared with the names that were found, so no path is made
from a URL. A damaged dataset is listed with its error.
"""

from __future__ import annotations

import os
import threading
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from urllib.parse import quote

from starlette.exceptions import HTTPException

from factory.dataset.episode import Episode
from factory.dataset.reader import Dataset
from factory.dataset.site import site_of
from factory.web.context import PageFrame, WebContext
from factory.web.recent import Recent
from factory.web.table import read_first_rows
from factory.web.thumbnails import ThumbnailStore, dataset_version, short_digest
from factory.web.workspace import Workspace
from schemas.errors import ArchiveCorrupt, FactoryError, WorldError
from schemas.storage.dataset_files import EPISODES, METADATA_FILE, is_dataset
from schemas.support.closing import Closing
from schemas.support.suggest import did_you_mean

DATASETS_PATH = "/datasets"
"""Prefix of the paths of all datasets; the name of the dataset follows."""
MOST_OPEN = 8
"""Number of datasets whose tables and frames are kept in memory."""
MOST_DATASETS = 500
"""Number of datasets that are listed."""
_MOST_ENTRIES = 10_000
"""Number of entries of the folder that are searched for datasets."""
_AGE_S = 3.0
"""Maximum age of the list, seconds."""


@dataclass(frozen=True)
class DatasetEntry:
    """Row of the list of datasets."""

    name: str
    base: str
    """Prefix of the paths of its pages; empty if it cannot be served."""
    plan: str = ""
    """Name of its plan."""
    episodes: int = 0
    """Number of episodes in its table."""
    planned: int = 0
    """Number of planned episodes."""
    state: str = ""
    """State of its run."""
    picture: str = ""
    """URL of the first frame of its first episode; empty without episodes."""
    fault: str = ""
    """Reason why it cannot be read, or an empty text."""


def find_datasets(folder: Path) -> list[str]:
    """Returns the names of the datasets in a folder, sorted: finished, unfinished and damaged ones.

    Raises:
        WorldError: the folder cannot be read.
    """
    try:
        with os.scandir(folder) as entries:
            names = [entry.name for entry in islice(entries, _MOST_ENTRIES) if not entry.name.startswith(".")]
    except OSError as error:
        raise WorldError(f"the folder {folder} cannot be read: {error.strerror}") from error
    return sorted(name for name in names if is_dataset(folder / name) or (folder / name / EPISODES).is_dir())


class DatasetFolder(Closing):
    """Datasets of one folder; thread-safe.

    Args:
        folder: the folder.
        open_context: function that returns the shared state of the pages of a dataset, given its directory, the prefix
            of their paths, and the cache of thumbnails that all datasets share.
    """

    def __init__(self, folder: Path, open_context: Callable[[Path, str, ThumbnailStore], WebContext]) -> None:
        self.folder = folder
        """The folder."""
        self._open_context = open_context
        self._names, self._entries = Recent(self._find, _AGE_S), Recent(self._describe_all, _AGE_S)
        self._lock = threading.Lock()
        self._contexts: OrderedDict[str, WebContext] = OrderedDict()
        self._thumbnails = ThumbnailStore()

    @property
    def frame(self) -> PageFrame:
        return PageFrame(str(self.folder), "", (), ("/", "All datasets"))

    def entries(self) -> list[DatasetEntry]:
        """Returns the first `MOST_DATASETS` datasets."""
        return self._entries.get()

    def count(self) -> int:
        """Returns the number of datasets, listed or not."""
        return len(self._names.get())

    def context_of(self, name: str) -> WebContext:
        """Returns the shared state of the pages of a dataset; the most recently used ones stay open.

        Raises:
            HTTPException: the folder has no such dataset.
        """
        directory = self._directory(name)
        with self._lock:
            context = self._contexts.pop(name, None)
            if context is None:
                context = self._open_context(directory, _base_of(name), self._thumbnails)
            self._contexts[name] = context
            oldest = self._contexts.popitem(last=False)[1] if len(self._contexts) > MOST_OPEN else None
        if oldest is not None:
            oldest.statistics.close()
        return context

    def first_episode(self, name: str) -> Episode:
        """Returns the first episode of a dataset.

        Raises:
            HTTPException: the folder has no such dataset, or the dataset has no episode.
            FactoryError: the dataset is damaged.
        """
        dataset = Dataset(self._directory(name))
        if not len(dataset):
            raise HTTPException(404, f"dataset {name[:80]!r} has no episodes yet")
        return dataset[0]

    def picture(self, episode: Episode) -> bytes:
        """Returns the thumbnail of an episode as JPEG; raises the errors of `ThumbnailStore.encoded`."""
        return self._thumbnails.encoded(episode).result()

    def close(self) -> None:
        """Ends the drawing processes of all datasets."""
        with self._lock:
            contexts = [*self._contexts.values()]
            self._contexts.clear()
        for context in contexts:
            context.statistics.close()

    def _find(self) -> list[str]:
        return find_datasets(self.folder)

    def _directory(self, name: str) -> Path:
        names = self._names.get()
        if name not in names:
            near = did_you_mean(name[:80], names)
            raise HTTPException(404, f"the folder has no dataset {name[:80]!r}{near}")
        return self.folder / name

    def _describe_all(self) -> list[DatasetEntry]:
        return [describe_dataset(self.folder / name) for name in self._names.get()[:MOST_DATASETS]]


def describe_dataset(directory: Path) -> DatasetEntry:
    """Returns the row of a dataset; one that cannot be read has a `fault`."""
    name = directory.name
    try:
        base = _base_of(name)
    except UnicodeEncodeError:
        return DatasetEntry(repr(name), "", fault="its name is not valid UTF-8: rename the directory")
    workspace = Workspace(site_of(str(directory)), base=base)
    meta, first = workspace.meta(), read_first_rows(directory, 1)
    if meta is None or first is None:
        return _without_tables(workspace, name)
    version = short_digest(f"{name} {dataset_version(meta)} {first.rows}")
    return DatasetEntry(
        name,
        base,
        plan=", ".join(dict.fromkeys(plan.name for plan in meta.plans)),
        episodes=first.total,
        planned=meta.planned,
        state="running" if workspace.is_written() else "finished" if meta.complete else "incomplete",
        picture=f"/pictures/{quote(name, safe='')}?of={version}" if first.total else "",
    )


def _without_tables(workspace: Workspace, name: str) -> DatasetEntry:
    """Returns the row of a dataset whose tables are missing or damaged; no fault if its run has just started."""
    with suppress(FactoryError):
        farm = workspace.farm()
        if not farm.progress.jobs.get("archived"):
            state = "running" if workspace.is_written() else "incomplete"
            return DatasetEntry(name, workspace.base, farm.info.plan.name, 0, farm.progress.planned, state)
    return DatasetEntry(name, workspace.base, fault=_fault(workspace.site.state_dir))


def _fault(directory: Path) -> str:
    try:
        Dataset(directory).column("episode_id")
    except FactoryError as error:
        return str(error)
    return str(ArchiveCorrupt(f"{directory / METADATA_FILE} cannot be read"))


def _base_of(name: str) -> str:
    return f"{DATASETS_PATH}/{quote(name, safe='')}"
