"""Read-only looks at the ledger of a dataset directory, for the verbs that report. Never writes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from sqlalchemy.engine import Connection

from coordinator.engine import open_reader, sqlite_url
from coordinator.ledger import read_info
from coordinator.progress import read_progress
from schemas.errors import UsageError
from schemas.plan import Plan
from schemas.wire import Progress

__all__ = ["ledger_of", "plan_of", "progress_of", "read_ledger"]

_LEDGER = "ledger.db"


def ledger_of(root: Path) -> str:
    """Returns the URL of the ledger that a dataset directory holds by default."""
    return sqlite_url(root / _LEDGER)


@contextmanager
def read_ledger(root: Path, url: str | None = None) -> Iterator[Connection]:
    """Opens the ledger of a dataset for reading.

    Raises:
        UsageError: there is no such directory.
        WorldError: the directory holds no ledger.
    """
    if url is None and not root.is_dir():
        raise UsageError(f"no directory {root}; start a run with `factory run demo --out {root}`")
    engine = open_reader(url or ledger_of(root))
    try:
        with engine.connect() as connection:
            yield connection
    finally:
        engine.dispose()


def plan_of(root: Path) -> Plan | None:
    """Returns the plan a directory was begun with, or `None` when it holds no ledger."""
    if not (root / _LEDGER).is_file():
        return None
    with read_ledger(root) as connection:
        return read_info(connection).plan


def progress_of(root: Path, url: str | None = None) -> Progress:
    """Returns where the run of a directory stands."""
    with read_ledger(root, url) as connection:
        return read_progress(connection, datetime.now(UTC))
