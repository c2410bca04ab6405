"""Reads frames in threads, and keeps the most recently used episodes of a dataset open.

Threads run in parallel because decoding releases the GIL, and other processes render.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import parent_process
from typing import Any

from factory.dataset.reader import Dataset, Episode

MOST_OPEN = 128
"""Maximum number of open bundles; one takes 0.6 MiB and an open file. Opening it takes as long as decoding a frame."""


class OpenEpisodes:
    """Episodes of a dataset by position; a pickled copy has no open episodes."""

    def __init__(self, dataset: Dataset) -> None:
        self.dataset = dataset
        self._open: OrderedDict[int, Episode] = OrderedDict()

    def take(self, position: int) -> Episode:
        """Returns the episode at a position; it stays open until `trim`. Not to be called by several threads."""
        episode = self._open.pop(position, None) or self.dataset[position]
        self._open[position] = episode
        return episode

    def trim(self) -> None:
        """Closes the least recently used episodes, so `MOST_OPEN` remain."""
        while len(self._open) > MOST_OPEN:
            self._open.popitem(last=False)[1].close()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_open": OrderedDict()}


def for_each(work: Callable[[int], None], count: int, threads: int | None = None) -> None:
    """Calls `work` with 0 to `count - 1`, in threads; raises the first error.

    Args:
        work: Function that may be called by several threads at a time.
        count: Number of calls.
        threads: Number of threads. Default: one per core, or one in a worker process.
    """
    threads = min(count, threads or _usable_cores())
    for _ in map(work, range(count)) if threads < 2 else _pool(threads).map(work, range(count)):
        pass


def _usable_cores() -> int:
    return 1 if parent_process() is not None else len(os.sched_getaffinity(0))


_pools: dict[tuple[int, int], ThreadPoolExecutor] = {}


def _pool(threads: int) -> ThreadPoolExecutor:
    """Returns the thread pool of this process. A forked process creates a new one, because a fork copies no threads."""
    key = (os.getpid(), threads)
    if key not in _pools:
        _pools[key] = ThreadPoolExecutor(threads, "read")
    return _pools[key]
