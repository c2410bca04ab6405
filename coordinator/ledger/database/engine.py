"""Opens the ledger's database by URL, with one writing engine or with read-only engines.

SQLite transactions are durable and exclusive from the first statement. An advisory lock ensures that a PostgreSQL
database has one writer. A digest of a closed SQLite ledger (`ledger.digest`) spares the next start its audit. The
module contains all code that is specific to SQLite; it creates no table and runs no query on the ledger's tables.
"""

from __future__ import annotations

import contextlib
import functools
import os
import sqlite3
import stat
import time
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import xxhash
from sqlalchemy import URL, Engine, create_engine, event, make_url, text
from sqlalchemy.engine import Connection, ExceptionContext
from sqlalchemy.exc import ArgumentError, DatabaseError, NoSuchModuleError, OperationalError
from sqlalchemy.pool import NullPool

from schemas.errors import UsageError, WorldError
from schemas.storage.mounts import MOUNTS, mount_of
from schemas.support.shell import quoted

_SUFFIX = ".digest"
_PIECE_BYTES = 1 << 20


def write_closed_digest(url: str) -> None:
    """Records the digest of a closed ledger, unless it has a write-ahead log, which the digest does not cover."""
    with contextlib.suppress(OSError):  # without the digest, the next start audits the ledger
        for file in _whole_file(url):
            file.with_suffix(_SUFFIX).write_text(_digest(file))


def share_finished(url: str) -> None:
    """Gives the files of a finished ledger the reading permissions of their folder; its leases are worthless now."""
    for file in sqlite_files(url):
        with contextlib.suppress(OSError):  # another user owns the file
            readable = stat.S_IMODE(file.parent.stat().st_mode) & _READ
            file.chmod(stat.S_IMODE(file.stat().st_mode) | readable)


def is_unchanged(url: str) -> bool:
    """Returns whether a ledger is unchanged since this version of the software closed it."""
    # a flipped bit changes neither the size nor the time of a file, so all bytes are compared
    try:
        return any(file.with_suffix(_SUFFIX).read_text() == _digest(file) for file in _whole_file(url))
    except (OSError, UnicodeDecodeError):
        return False


def _whole_file(url: str) -> Iterator[Path]:
    """Yields the database file, if it exists and its write-ahead log is missing or empty."""
    files = sqlite_files(url)
    if files and not any(path.name.endswith("-wal") and path.stat().st_size for path in files):
        yield files[-1]


def _digest(file: Path) -> str:
    digest = xxhash.xxh3_128(version("minivla-factory").encode())
    with file.open("rb") as stream:
        while piece := stream.read(_PIECE_BYTES):
            digest.update(piece)
    return digest.hexdigest()


_EXAMPLES = "examples: sqlite:///PATH or postgresql+psycopg://USER@HOST/DATABASE"
_LOCK = 0x6D696E69766C61
"""Key of the advisory lock, which allows one writer per database."""
_LOCK_HELD = text("""
    SELECT 1 FROM pg_locks WHERE locktype = 'advisory' AND granted AND objsubid = 1 AND classid = :high AND objid = :low
        AND database = (SELECT oid FROM pg_database WHERE datname = current_database())""")
_OTHERS, _READ = 0o007, 0o444
_LOCK_WAIT_S, _LOCK_PAUSE_S = 3.0, 0.2
"""Longest wait for the lock and pause between attempts, seconds. The wait is needed because a server detects late that
a client was killed."""
_SERVER_WAIT = {"connect_timeout": 5}
"""Longest wait for a connection to a server, seconds; without it, a host that drops packets blocks for two minutes."""
_KEPT_READERS = 8
"""Number of SQLite files whose reading engines are kept."""
_PRAGMAS = ("journal_mode=WAL", "synchronous=FULL", "busy_timeout=30000", "mmap_size=0", "foreign_keys=ON")


def sqlite_url(file: Path) -> str:
    return f"sqlite:///{file}"


def open_writer(url: str, mounts: Path = MOUNTS) -> Engine:
    """Returns the engine of the single writer.

    On SQLite it uses WAL, synchronous=FULL and BEGIN IMMEDIATE, so a commit survives a power failure and a
    transaction cannot fail because of another writer. On a server it uses one connection, which holds the database's
    lock.

    Args:
        url: URL of the database.
        mounts: list of mounts of this host.

    Raises:
        UsageError: this installation cannot open the database of the URL.
        WorldError: the server cannot be reached, another coordinator writes to the database, or an SQLite file is on a
            network file system.
    """
    if is_server(url):
        engine = _create(url, pool_size=1, max_overflow=0, pool_pre_ping=True, connect_args=_SERVER_WAIT)
        event.listen(engine, "connect", _hold_alone)
        _reach(engine)
        return engine
    engine = _create(url)
    if engine.dialect.name == "sqlite":
        _require_local_disk(_sqlite_file(url), mounts)
        _keep_private(url)
        event.listen(engine, "connect", _prepare_writer)
        event.listen(engine, "begin", _begin_immediate)
    return engine


def open_reader(url: str) -> Engine:
    """Returns a read-only engine; on SQLite it opens the file read-only.

    Raises:
        UsageError: this installation cannot open the database of the URL.
        WorldError: the SQLite file does not exist, or the server cannot be reached.
    """
    if is_server(url):
        options = {"options": "-c default_transaction_read_only=on", **_SERVER_WAIT}
        engine = _create(url, connect_args=options, pool_pre_ping=True)
        _reach(engine)
        return engine
    file = _sqlite_file(url)
    if not file.is_file():
        raise WorldError(f"no ledger at {file}; start a run with `factory run` or `factory coordinator start`")
    if not all(os.access(path, os.R_OK) for path in sqlite_files(url)):
        raise WorldError(
            f"no permission to read the ledger {file}, which belongs to {_owner_of(file)}: it is private until its run "
            "is finished, because it contains lease tokens. While the run lasts, `factory status --connect ENDPOINT` "
            f"asks its coordinator; after it, the owner can run `chmod a+r {quoted(file)}`"
        )
    return _reader_of(file)


def _owner_of(file: Path) -> str:
    try:
        return file.owner()
    except (KeyError, OSError):
        return "another user"


@functools.lru_cache(maxsize=_KEPT_READERS)
def _reader_of(file: Path) -> Engine:
    """Returns the engine of a file; cached, because compiling its statements takes longer than connecting."""
    return create_engine("sqlite://", creator=lambda: _connect_readonly(file), poolclass=NullPool)


def sqlite_files(url: str) -> list[Path]:
    """Returns the existing files of an SQLite ledger, with the database file last; empty for other databases."""
    if make_url(url).get_backend_name() != "sqlite":
        return []
    file = _sqlite_file(url)
    return [path for suffix in ("-shm", "-wal", "") if (path := file.with_name(file.name + suffix)).exists()]


def checkpoint_log(connection: Connection) -> None:
    """Checkpoints SQLite's write-ahead log outside a transaction. Does nothing for other databases."""
    if connection.dialect.name == "sqlite":
        raw = connection.connection.driver_connection
        if isinstance(raw, sqlite3.Connection):
            raw.execute("PRAGMA wal_checkpoint(TRUNCATE)")


def _require_local_disk(file: Path, mounts: Path) -> None:
    mount = mount_of(file, mounts)
    if mount is not None and mount.is_network:
        raise WorldError(
            f"the ledger {file} is on a network file system ({mount.kind} at {mount.folder}), which can damage "
            "an SQLite database: choose an --out on a local disk or in object storage, or give --ledger, either "
            "sqlite:////LOCAL/ledger.db on a local disk or postgresql+psycopg://USER@HOST/DATABASE"
        )


def _keep_private(url: str) -> None:
    """Removes the permissions of other users from the ledger's files, which hold lease tokens; groups keep theirs."""
    database = make_url(url).database
    if not database or database.startswith((":", "file:")):
        return
    with contextlib.suppress(FileExistsError, FileNotFoundError):  # the database reports a missing folder
        os.close(os.open(database, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600))
    for path in sqlite_files(url):
        mode = path.stat().st_mode
        if mode & _OTHERS:
            with contextlib.suppress(PermissionError):  # another user owns the file
                path.chmod(stat.S_IMODE(mode) & ~_OTHERS)


def _sqlite_file(url: str) -> Path:
    return Path(make_url(url).database or "")


def is_server(url: str) -> bool:
    """Returns whether a database server stores the ledger.

    Raises:
        UsageError: the URL cannot be understood.
    """
    try:
        return make_url(url).get_backend_name() == "postgresql"
    except ArgumentError as error:
        raise UsageError(f"the ledger's URL is not valid: {error}; {_EXAMPLES}") from error


def _create(url: str, **options: Any) -> Engine:
    try:
        engine = create_engine(url, **options)
        event.listen(engine, "handle_error", _close_lost_cursor)
        return engine
    except ImportError as error:
        raise UsageError(
            f"cannot open ledger {shown_url(url)}: {error}; for PostgreSQL: pip install 'psycopg[binary]', and use a "
            "URL that begins with postgresql+psycopg://"
        ) from error
    except (ArgumentError, NoSuchModuleError) as error:
        raise UsageError(f"cannot open ledger {shown_url(url)}: {error}; {_EXAMPLES}") from error


def _close_lost_cursor(context: ExceptionContext) -> None:
    """Closes the cursor of a lost connection, which SQLAlchemy leaves to the garbage collector; psycopg warns then."""
    cursor = context.execution_context.cursor if context.execution_context is not None else None
    if context.is_disconnect and cursor is not None:
        with contextlib.suppress(Exception):  # the connection is lost; the error that is handled says so
            cursor.close()


def shown_url(url: str) -> str:
    """Returns a URL with its password hidden."""
    return make_url(url).render_as_string(hide_password=True)


def public_url(url: str) -> str:
    """Returns a URL without its password and its parameters, which can contain secrets."""
    full = make_url(url)
    place = URL.create(full.drivername, full.username, host=full.host, port=full.port, database=full.database)
    return place.render_as_string(hide_password=False)


def remedy_for(url: str) -> str:
    """Returns what to do about a ledger that cannot be read, as the end of a sentence."""
    if is_server(url):
        return (
            "restore the database, or rebuild it from the episodes with `factory repair DIR --ledger` and the URL of "
            "an empty database"
        )
    return "`factory repair` rebuilds it from the episodes"


def is_outage(url: str, error: DatabaseError) -> bool:
    """Returns whether a database server did not answer, so that the same statement can succeed later."""
    return is_server(url) and (isinstance(error, OperationalError) or error.connection_invalidated)


def has_writer(connection: Connection) -> bool | None:
    """Returns whether a coordinator holds the writer's lock; `None` if the database has no such lock."""
    if connection.dialect.name != "postgresql":
        return None
    return connection.execute(_LOCK_HELD, {"high": _LOCK >> 32, "low": _LOCK & 0xFFFFFFFF}).first() is not None


def _reach(engine: Engine) -> None:
    try:
        with engine.connect():
            return
    except DatabaseError as error:
        shown = engine.url.render_as_string(hide_password=True)
        engine.dispose()
        reason = " ".join(str(error.orig).split())
        raise WorldError(
            f"ledger {shown} cannot be reached: {reason}; check that the server is running and that the database exists"
        ) from error
    except WorldError:
        engine.dispose()
        raise


def _hold_alone(raw: Any, _record: object) -> None:
    """Takes the writer's lock on a new connection; the server releases it when the connection ends."""
    deadline = time.monotonic() + _LOCK_WAIT_S
    while True:
        with raw.cursor() as cursor:
            cursor.execute("SELECT pg_try_advisory_lock(%s)", (_LOCK,))
            (is_ours,) = cursor.fetchone()
        raw.commit()
        if is_ours:
            return
        if time.monotonic() > deadline:
            raw.close()
            raise WorldError(
                "the ledger's database is in use by another coordinator: stop it first, or give another --ledger"
            )
        time.sleep(_LOCK_PAUSE_S)


def _prepare_writer(raw: Any, _record: object) -> None:
    raw.isolation_level = None  # prevents implicit transactions of the driver
    for pragma in _PRAGMAS:
        raw.execute(f"PRAGMA {pragma}")


def _begin_immediate(connection: Connection) -> None:
    connection.exec_driver_sql("BEGIN IMMEDIATE")


def _connect_readonly(file: Path) -> sqlite3.Connection:
    log = file.with_name(file.name + "-wal")
    # a running writer has a log, and a killed writer leaves its log; so without a log no process writes. Unless the
    # file is opened as immutable, SQLite would then create a log, leave it behind, and fail on a read-only disk
    if not log.exists():
        return _open_readonly(file, "mode=ro&immutable=1")
    try:
        return _open_readonly(file, "mode=ro")
    except sqlite3.OperationalError:
        if log.exists() and log.stat().st_size:
            raise
        return _open_readonly(file, "mode=ro&immutable=1")


def _open_readonly(file: Path, how: str) -> sqlite3.Connection:
    raw = sqlite3.connect(f"{file.absolute().as_uri()}?{how}", uri=True, timeout=30, check_same_thread=False)
    try:
        raw.execute("PRAGMA query_only=ON")
        raw.execute("PRAGMA schema_version")  # the first access to the file
    except sqlite3.Error:
        raw.close()
        raise
    return raw
