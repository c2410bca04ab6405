"""Checks episodes in this process, or in several processes if that saves more time than their start takes.

The checks themselves are in `factory/verify/episode.py`.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import chain, islice

from factory.support.logs import configure_logs
from factory.verify.episode import EpisodeCheck, EpisodeFindings, check_episode

_ROWS_AT_A_TIME = 2000
_CHECKS_AT_A_TIME = 4
_BYTES_PER_S = 75e6
_EPISODE_S = 0.01
"""Part of the CPU time of a deep check that does not depend on the size of the episode, seconds."""
_WORTH_A_PROCESS_S = 2.0
"""CPU time of checks that justifies one more process, seconds: twice the CPU time of its start and imports."""


def run_checks(checks: Iterator[EpisodeCheck], processes: int | None) -> Iterator[EpisodeFindings]:
    """Yields the result of each check, in the order of the checks.

    Args:
        checks: Checks, read as they are needed.
        processes: Number of processes; 1 runs in the calling process. `None` uses the result of `useful_processes`.
    """
    batch = list(islice(checks, _ROWS_AT_A_TIME))
    count = min(useful_processes(batch, os.cpu_count() or 1) if processes is None else processes, len(batch))
    if count <= 1:
        yield from map(check_episode, chain(batch, checks))
        return
    fresh = multiprocessing.get_context("spawn")  # a fork would copy locks held by other threads
    with ProcessPoolExecutor(count, fresh, initializer=configure_logs) as pool:
        while batch:  # `pool.map` reads all of its input at once
            yield from pool.map(check_episode, batch, chunksize=_CHECKS_AT_A_TIME if len(batch) > 100 else 1)
            batch = list(islice(checks, _ROWS_AT_A_TIME))


def useful_processes(checks: Sequence[EpisodeCheck], cores: int) -> int:
    """Returns the number of processes that finish the checks soonest; at most one per core.

    Each episode that is rendered again justifies a process, because rendering it takes seconds.
    """
    rendered = sum(check.render for check in checks)
    work_s = sum(_EPISODE_S + check.row.file_bytes / _BYTES_PER_S for check in checks if check.deep)
    return max(1, min(cores, rendered + int(work_s / _WORTH_A_PROCESS_S)))
