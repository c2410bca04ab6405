"""Sets aside a ledger that cannot be used, so that a new one is begun in its place and rebuilt from the episodes."""

from __future__ import annotations

import structlog

from coordinator.archive.contract import Archive
from coordinator.expansion.catalog import Catalog
from coordinator.ledger.engine import is_server, shown_url, sqlite_files
from coordinator.ledger.reading.audit import ledger_trouble
from schemas.errors import WorldError

__all__ = ["renew_ledger", "set_aside_ledger"]

log = structlog.get_logger(__name__)


def renew_ledger(archive: Archive, url: str, catalog: Catalog) -> None:
    """Sets the ledger of a run aside when it cannot be used; a sound one stays.

    Args:
        archive: of the run, held exclusively.
        url: of the ledger.
        catalog: scenes of the run.

    Raises:
        WorldError: a database server holds a damaged ledger, which only its operator can set aside.
        UsageError: the ledger is of a newer format.
    """
    trouble = ledger_trouble(url, catalog)
    if not trouble:
        return
    if is_server(url) and "lacks the tables" not in trouble:
        raise WorldError(
            f"the ledger {shown_url(url)} {trouble}: restore the database from a backup, or give an empty one with "
            f"--ledger; `factory repair {archive.root}` then rebuilds it from the episodes"
        )
    set_aside_ledger(archive, url, trouble)
    if episodes := len(archive.present()):
        log.warning("ledger_rebuilt", ledger=shown_url(url), why=trouble, episodes=episodes, remedy="none")


def set_aside_ledger(archive: Archive, url: str, why: str) -> None:
    """Moves the files of an SQLite ledger into quarantine, its log before it; a lost ledger may have left a log.

    A log that stayed would be replayed into the next ledger of that name.
    """
    for file in sqlite_files(url):
        archive.quarantine(file, f"the ledger {why}")
