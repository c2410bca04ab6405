"""Runs tasks in spawned processes with a bounded queue. The processes end when the parent stops them or dies."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from typing import TypeVar

from factory.support.logs import configure_logs
from schemas.errors import WorldError

Asked = TypeVar("Asked")
Answer = TypeVar("Answer")
_AHEAD = 2
_GLANCE_S = 0.2


def run_tasks(
    function: Callable[[Asked], Answer], tasks: Iterable[Asked], workers: int, stop: threading.Event
) -> Iterator[Answer]:
    """Yields the results in order of completion. Ends early, without the tasks in progress, when `stop` is set.

    Args:
        function: importable function; its arguments and results must be picklable.
        tasks: arguments, consumed as processes become idle.
        workers: number of processes; 0 runs all tasks in this process.
        stop: event that is polled several times per second.

    Raises:
        WorldError: a process died.
    """
    if workers == 0:
        for task in tasks:
            if stop.is_set():
                return
            yield function(task)
        return
    fresh = multiprocessing.get_context("spawn")  # a fork would copy locks held by threads
    theirs, ours = fresh.Pipe(duplex=False)
    pool = ProcessPoolExecutor(workers, mp_context=fresh, initializer=_begin, initargs=(theirs,))
    try:
        yield from _feed(pool, function, tasks=iter(tasks), ahead=workers * _AHEAD, stop=stop)
    except BrokenProcessPool as error:
        died = "a process died (it was killed, or is out of memory); finished work is kept"
        raise WorldError(f"{died}: run the same command again, with fewer --workers if memory is short") from error
    finally:
        ours.close()  # ends processes that still run
        pool.shutdown(wait=True, cancel_futures=True)
        theirs.close()


def _feed(
    pool: ProcessPoolExecutor,
    function: Callable[[Asked], Answer],
    tasks: Iterator[Asked],
    ahead: int,
    stop: threading.Event,
) -> Iterator[Answer]:
    flying: set[Future[Answer]] = set()
    more = True
    while not stop.is_set():
        while more and len(flying) < ahead:
            task = next(tasks, None)
            if task is None:
                more = False
                break
            flying.add(pool.submit(function, task))
        if not flying:
            return
        done, flying = wait(flying, _GLANCE_S, FIRST_COMPLETED)
        for future in done:
            yield future.result()


def _begin(parent_pipe: Connection) -> None:
    """Initialises a process: it logs to stderr, ignores Ctrl-C, which the parent handles, and ends with the parent."""
    configure_logs()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent_pipe,), name="parent_pipe", daemon=True).start()


def _end_with(parent_pipe: Connection) -> None:
    try:
        parent_pipe.recv_bytes()
    except (EOFError, OSError):
        os._exit(1)
