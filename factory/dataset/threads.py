"""Reads frames in threads, which run in parallel: decoding releases the GIL, and other processes render."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import parent_process


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
