"""Tasks over spawned processes, a bounded number in flight, ended at once when told or when the parent dies."""

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

from schemas.errors import WorldError

__all__ = ["carry_out"]

Asked = TypeVar("Asked")
Answer = TypeVar("Answer")
_AHEAD = 2
_GLANCE_S = 0.2


def carry_out(
    do: Callable[[Asked], Answer], tasks: Iterable[Asked], workers: int, stop: threading.Event
) -> Iterator[Answer]:
    """Yields the answers as they come, in any order; ends early, without those in flight, once `stop` is set.

    Args:
        do: importable by name; its arguments and answers can be pickled.
        tasks: drawn from as processes become free.
        workers: processes; 0 does everything in this one.
        stop: looked at a few times a second.

    Raises:
        WorldError: a process died.
    """
    if workers == 0:
        for task in tasks:
            if stop.is_set():
                return
            yield do(task)
        return
    fresh = multiprocessing.get_context("spawn")  # a fork would copy locks that threads of ours may hold
    theirs, ours = fresh.Pipe(duplex=False)
    pool = ProcessPoolExecutor(workers, mp_context=fresh, initializer=_begin, initargs=(theirs,))
    try:
        yield from _feed(pool, do, iter(tasks), workers * _AHEAD, stop)
    except BrokenProcessPool as error:
        died = "a process of the export died (killed, or out of memory?); what is done is kept"
        raise WorldError(f"{died}: call it again, with fewer --workers if memory is short") from error
    finally:
        ours.close()  # ends whatever still runs
        pool.shutdown(wait=True, cancel_futures=True)
        theirs.close()


def _feed(
    pool: ProcessPoolExecutor,
    do: Callable[[Asked], Answer],
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
            flying.add(pool.submit(do, task))
        if not flying:
            return
        done, flying = wait(flying, _GLANCE_S, FIRST_COMPLETED)
        for future in done:
            yield future.result()


def _begin(leash: Connection) -> None:
    """Ties this process to its parent: Ctrl-C is the parent's to handle, and its end is ours."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(leash,), name="leash", daemon=True).start()


def _end_with(leash: Connection) -> None:
    try:
        leash.recv_bytes()
    except (EOFError, OSError):
        os._exit(1)
