"""Writes the ledger: one thread executes queued work in group commits, another resolves the results after COMMIT.

The module is independent of jobs and of zenoh. Work must depend on the connection only, because it may run twice.
"""

from __future__ import annotations

import queue
import sqlite3
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import Any, Generic, TypeVar

import structlog
from sqlalchemy import Engine
from sqlalchemy.engine import Connection
from sqlalchemy.exc import DatabaseError, OperationalError, SQLAlchemyError

from coordinator.ledger.database.engine import checkpoint_log
from schemas.errors import TransientError, WorldError
from schemas.support.closing import Closing
from schemas.support.log_limit import LogLimit, Repeated, describe_error

GROUP = 256
"""Maximum number of requests per commit."""

T = TypeVar("T")
log = structlog.get_logger(__name__)
_LIMIT = LogLimit()


class _Request(Generic[T]):
    """Queued work with the future of its result."""

    def __init__(self, work: Callable[[Connection], T]) -> None:
        self.work = work
        self.future: Future[T] = Future()

    def resolve(self, outcome: T | Exception) -> None:
        """Sets the result or the exception of the future; its callbacks run in the calling thread."""
        if isinstance(outcome, Exception):
            self.future.set_exception(outcome)
        else:
            self.future.set_result(outcome)


class Writer(Closing):
    """Owner of the only read-write connection; a context manager. Closing it completes the queued work."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        where = "disk" if engine.dialect.name == "sqlite" else "server"
        self._failing = Repeated(log.bind(remedy=f"check the ledger's {where}"), "commit_failed", (SQLAlchemyError,))
        self._queue: queue.SimpleQueue[_Request[Any] | None] = queue.SimpleQueue()
        self._closed = False
        self._closing = threading.Lock()
        self.damage = ""
        """Reason why the database can no longer be written; empty while a retry may succeed."""
        self.commits = 0
        """Number of commits."""
        self._answers: queue.SimpleQueue[tuple[_Request[Any], Any] | None] = queue.SimpleQueue()
        self._threads = (
            threading.Thread(target=self._run, name="ledger-writer"),
            threading.Thread(target=self._answer, name="ledger-answers"),
        )
        for thread in self._threads:
            thread.start()

    @property
    def is_alive(self) -> bool:
        return all(thread.is_alive() for thread in self._threads)

    @property
    def backlog(self) -> int:
        """Number of requests that wait for their commit or their result."""
        return self._queue.qsize() + self._answers.qsize()

    def cpu_s(self) -> float:
        """Returns the CPU time of the writing thread, seconds."""
        return time.clock_gettime(time.pthread_getcpuclockid(self._threads[0].ident or 0))

    def submit(self, work: Callable[[Connection], T]) -> Future[T]:
        """Queues work for the next commit.

        Returns:
            The future of the result, resolved after COMMIT; its exception is `TransientError` if the database could not
            commit or the writer is closed.
        """
        request = _Request(work)
        with self._closing:
            if self._closed:
                request.resolve(TransientError("the ledger is closed; ask again when the coordinator is back"))
            else:
                self._queue.put(request)
        return request.future

    def call(self, work: Callable[[Connection], T]) -> T:
        """Executes work in the next commit and returns its result.

        Raises:
            TransientError: the database could not commit, or the writer is closed.
        """
        return self.submit(work).result()

    def close(self) -> None:
        """Completes the queued work, checkpoints the write-ahead log and ends the threads."""
        with self._closing:
            if not self._closed:
                self._closed = True
                self._queue.put(None)
        for thread in self._threads:
            thread.join()

    def _run(self) -> None:
        try:
            with self._engine.connect() as connection:
                is_open = True
                while is_open:
                    batch, is_open = self._next_batch()
                    if batch:
                        self._commit(connection, batch)
                checkpoint_log(connection)
        except (SQLAlchemyError, sqlite3.Error) as error:
            self.damage = self.damage or str(error)
            log.error("ledger_lost", error=str(error), remedy="start again: the ledger is rebuilt from the episodes")
        finally:
            self._answers.put(None)

    def _answer(self) -> None:
        """Resolves results in the order of their commits, in parallel with the next commit."""
        while (answer := self._answers.get()) is not None:
            request, outcome = answer
            request.resolve(outcome)

    def _next_batch(self) -> tuple[list[_Request[Any]], bool]:
        """Waits for work and returns up to `GROUP` requests; the flag is `False` after the writer was closed."""
        batch: list[_Request[Any]] = []
        request = self._queue.get()
        while request is not None:
            batch.append(request)
            if len(batch) == GROUP:
                return batch, True
            try:
                request = self._queue.get_nowait()
            except queue.Empty:
                return batch, True
        return batch, False

    def _commit(self, connection: Connection, batch: Sequence[_Request[Any]]) -> None:
        try:
            outcomes = _run_together(connection, batch)
            self.commits += 1
            self._failing.succeed()
        except Exception:  # noqa: BLE001 - some request fails: isolate it
            outcomes = self._commit_apart(connection, batch)
        for answer in zip(batch, outcomes, strict=True):
            self._answers.put(answer)

    def _commit_apart(self, connection: Connection, batch: Sequence[_Request[Any]]) -> list[Any]:
        """Executes each request under a savepoint, so a failing request does not affect the others."""
        try:
            with connection.begin():
                outcomes = [_run_guarded(connection, request) for request in batch]
        except (SQLAlchemyError, WorldError) as error:
            self._failing.fail(error, requests=len(batch))
            if _is_final(error):
                self.damage = str(error)
            return [_transient(error)] * len(batch)
        self.commits += 1
        self._failing.succeed()
        return outcomes


def _is_final(error: SQLAlchemyError | WorldError) -> bool:
    """Returns whether the database file is damaged; a full disk or a lost server connection is not damage."""
    original = error.orig if isinstance(error, DatabaseError) else None
    code = getattr(original, "sqlite_errorcode", 0)
    return code & 0xFF in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)


def _run_together(connection: Connection, batch: Sequence[_Request[Any]]) -> list[Any]:
    with connection.begin():
        return [request.work(connection) for request in batch]


def _run_guarded(connection: Connection, request: _Request[Any]) -> Any:
    savepoint = connection.begin_nested()
    try:
        result = request.work(connection)
    except OperationalError:
        raise  # a full disk or a lost server ends the transaction with all its savepoints
    except SQLAlchemyError as error:
        savepoint.rollback()
        _log_error("request_failed", error)
        return _transient(error)
    except Exception as error:  # noqa: BLE001 - passed to the caller of the request
        savepoint.rollback()
        return error
    savepoint.commit()
    return result


def _log_error(event: str, error: SQLAlchemyError | WorldError, **fields: Any) -> None:
    """Logs a database error without the parameters of the statement, which contain tokens."""
    _LIMIT.write(log.error, event, error=describe_error(getattr(error, "orig", None) or error), **fields)


def _transient(error: SQLAlchemyError | WorldError) -> TransientError:
    failure = TransientError(f"the write to the ledger failed: {error}; check its disk or server, then try again")
    failure.__cause__ = error
    return failure
