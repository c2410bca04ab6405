"""Opens the ledger's database by URL: one writing engine, or readers that cannot write. Only here SQLite is known.

Makes every SQLite transaction durable and exclusive from its first statement; creates no table and runs no query.
"""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any

from sqlalchemy import Engine, create_engine, event, inspect, make_url
from sqlalchemy.engine import Connection
from sqlalchemy.exc import ArgumentError, DatabaseError, NoSuchModuleError
from sqlalchemy.pool import NullPool

from coordinator.tables import METADATA
from schemas.errors import UsageError, WorldError

__all__ = ["checkpoint_log", "ledger_trouble", "open_reader", "open_writer", "sqlite_files", "sqlite_url"]

_PRAGMAS = ("journal_mode=WAL", "synchronous=FULL", "busy_timeout=30000", "mmap_size=0", "foreign_keys=ON")


def sqlite_url(file: Path) -> str:
    """Returns the URL of an SQLite ledger in that file."""
    return f"sqlite:///{file}"


def open_writer(url: str) -> Engine:
    """Returns the engine of the one writer.

    On SQLite: WAL, synchronous=FULL, and BEGIN IMMEDIATE, so that a commit survives a power cut and a transaction
    never finds out half way that another one wrote.

    Raises:
        UsageError: the URL names a database this installation cannot open.
    """
    engine = _create(url)
    if engine.dialect.name == "sqlite":
        event.listen(engine, "connect", _prepare_writer)
        event.listen(engine, "begin", _begin_immediate)
    return engine


def open_reader(url: str) -> Engine:
    """Returns an engine for reading; on SQLite the file is opened read-only.

    Raises:
        UsageError: the URL names a database this installation cannot open.
        WorldError: there is no such SQLite file.
    """
    if make_url(url).get_backend_name() != "sqlite":
        return _create(url)
    file = _sqlite_file(url)
    if not file.is_file():
        raise WorldError(f"no ledger at {file}; start a run there with `factory run` or `factory coordinator start`")
    return create_engine("sqlite://", creator=lambda: _connect_readonly(file), poolclass=NullPool)


def ledger_trouble(url: str) -> str:
    """Returns why a ledger cannot be used, in words; empty when it is whole as far as its database can tell.

    Raises:
        UsageError: the URL names a database this installation cannot open.
    """
    if make_url(url).get_backend_name() == "sqlite" and not _sqlite_file(url).is_file():
        return "is not there"
    engine = open_reader(url)
    try:
        with engine.connect() as connection:
            if connection.dialect.name == "sqlite":
                said = connection.exec_driver_sql("PRAGMA quick_check(1)").scalar_one()
                if said != "ok":
                    return f"is damaged: {said}"
            tables = set(inspect(connection).get_table_names())
            missing = sorted(METADATA.tables.keys() - tables)
            return f"lacks the tables {', '.join(missing)}" if missing else ""
    except DatabaseError as error:
        return f"cannot be read: {error.orig}"
    finally:
        engine.dispose()


def sqlite_files(url: str) -> list[Path]:
    """Returns the files of an SQLite ledger that are there, its log first; none for another database."""
    if make_url(url).get_backend_name() != "sqlite":
        return []
    file = _sqlite_file(url)
    return [path for suffix in ("-shm", "-wal", "") if (path := file.with_name(file.name + suffix)).exists()]


def checkpoint_log(connection: Connection) -> None:
    """Folds SQLite's write-ahead log into the database file, outside a transaction; elsewhere does nothing."""
    if connection.dialect.name == "sqlite":
        raw = connection.connection.driver_connection
        if isinstance(raw, sqlite3.Connection):
            raw.execute("PRAGMA wal_checkpoint(TRUNCATE)")


def _sqlite_file(url: str) -> Path:
    return Path(make_url(url).database or "")


def _create(url: str) -> Engine:
    try:
        return create_engine(url)
    except (ArgumentError, NoSuchModuleError, ImportError) as error:
        raise UsageError(
            f"cannot open ledger {url!r}: {error}; give e.g. sqlite:///PATH or install the driver"
        ) from error


def _prepare_writer(raw: Any, _record: object) -> None:
    raw.isolation_level = None  # the driver must not begin transactions of its own
    for pragma in _PRAGMAS:
        raw.execute(f"PRAGMA {pragma}")


def _begin_immediate(connection: Connection) -> None:
    connection.exec_driver_sql("BEGIN IMMEDIATE")


def _connect_readonly(file: Path) -> sqlite3.Connection:
    raw = sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro", uri=True, timeout=30, check_same_thread=False)
    raw.execute("PRAGMA query_only=ON")
    return raw
