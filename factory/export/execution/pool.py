"""Exports episodes in spawned processes with a bounded queue. The processes end when the parent stops them or dies.

A task writes into its staging folder only.
"""

from __future__ import annotations

import multiprocessing
import os
import shutil
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TypeVar

from factory.dataset.episode import Episode
from factory.export.output import sync_tree
from factory.export.registry import find_exporter
from factory.support.logs import configure_logs
from schemas.base import Model
from schemas.errors import ArchiveCorrupt, InvalidBundle, WorldError
from schemas.storage.disk import translated

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
        yield from _feed(pool, function, iter(tasks), workers * _AHEAD, stop)
    except BrokenProcessPool as error:
        died = "a process of the export died (it was killed, or is out of memory); finished work is kept"
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


class ExportTask:
    """Picklable task: one episode to export."""

    def __init__(self, exporter: str, options: str, episode: Episode, folder: Path) -> None:
        self.exporter = exporter
        self.options = options
        """Options as JSON."""
        self.episode = episode
        self.folder = folder
        """Staging folder; it does not exist yet."""


class PieceResult(Model):
    """Result of a task: facts or damage."""

    episode_id: str
    facts: str | None = None
    """Facts as JSON; the folder contains the synced piece."""
    damage: str | None = None
    """Reason why the episode could not be exported; the folder is deleted."""
    frames: int = 0


def make_piece(task: ExportTask) -> PieceResult:
    """Exports one episode into its staging folder.

    Raises:
        WorldError: the disk is full or not available; the folder is deleted.
    """
    name, folder = task.episode.episode_id, task.folder
    exporter = find_exporter(task.exporter)
    options = exporter.options.model_validate_json(task.options)
    whole = False
    try:
        with translated("write", folder), task.episode as episode:
            folder.mkdir(parents=True)
            _require_as_listed(episode)
            facts = exporter.write_episode(episode, options, folder)
            sync_tree(folder)
        whole = True
    except ArchiveCorrupt as error:
        return PieceResult(episode_id=name, damage=str(error))
    except InvalidBundle as error:
        text = f"{task.episode.path} is damaged ({'; '.join(error.findings)}): run `factory verify --deep`"
        return PieceResult(episode_id=name, damage=text)
    finally:
        if not whole:
            shutil.rmtree(folder, ignore_errors=True)
    return PieceResult(episode_id=name, facts=facts.model_dump_json(), frames=facts.frames)


def _require_as_listed(episode: Episode) -> None:
    """Validates that the content of a file matches its row of the metadata."""
    meta, row = episode.meta, episode.summary
    if (meta.episode_id, meta.content_digest) != (row.episode_id, row.content_digest):
        found = f"{meta.episode_id} with content digest {meta.content_digest}, the metadata says {row.content_digest}"
        raise ArchiveCorrupt(f"{episode.path} holds {found}: run `factory verify --deep`")
