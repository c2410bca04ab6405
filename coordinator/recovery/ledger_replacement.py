"""Quarantines an unusable ledger, so that a new ledger is created and rebuilt from the episodes. Creates no ledger."""

from __future__ import annotations

import structlog

from coordinator.archive.contract import Archive
from coordinator.expansion.catalog import Catalog
from coordinator.ledger.engine import is_server, shown_url, sqlite_files
from coordinator.ledger.reading.audit import ledger_trouble
from schemas.errors import WorldError

__all__ = ["quarantine_ledger", "replace_unusable_ledger"]

log = structlog.get_logger(__name__)


def replace_unusable_ledger(archive: Archive, url: str, catalog: Catalog) -> None:
    """Quarantines the ledger of a run if it is unusable; an intact ledger is not changed.

    Args:
        archive: archive of the run, held exclusively.
        url: URL of the ledger.
        catalog: compiled scenes of the run.

    Raises:
        WorldError: a database server stores a damaged ledger, which only its administrator can replace.
        UsageError: the ledger has a newer format.
    """
    trouble = ledger_trouble(url, catalog)
    if not trouble:
        return
    if is_server(url) and "lacks the tables" not in trouble:
        raise WorldError(
            f"the ledger {shown_url(url)} {trouble}: restore the database from a backup, or give an empty one with "
            f"--ledger; `factory repair {archive.root}` then rebuilds it from the episodes"
        )
    quarantine_ledger(archive, url, trouble)
    if episodes := len(archive.present()):
        log.warning("ledger_rebuilt", ledger=shown_url(url), why=trouble, episodes=episodes, remedy="none")


def quarantine_ledger(archive: Archive, url: str, why: str) -> None:
    """Moves the files of an SQLite ledger to the quarantine folder, the write-ahead log first.

    A lost ledger may leave a log, which SQLite would replay into the next ledger of the same name.
    """
    for file in sqlite_files(url):
        archive.quarantine(file, f"the ledger {why}")
