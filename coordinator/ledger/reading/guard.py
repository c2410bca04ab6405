"""Makes sure that a dataset far away is not opened without its ledger: all its episodes would pass for strays."""

from __future__ import annotations

from coordinator.archive.contract import Archive
from coordinator.ledger.engine import shown_url
from coordinator.ledger.reading.audit import ledger_trouble
from schemas.errors import WorldError
from schemas.storage.object_path import ObjectPath

__all__ = ["require_ledger"]


def require_ledger(archive: Archive, url: str) -> None:
    """Refuses a dataset in object storage that has episodes and whose ledger is not here.

    A directory and its ledger lie together; a bucket can be reached from where the ledger is not.

    Raises:
        WorldError: the ledger is not there, or damaged; names the remedies.
    """
    if not isinstance(archive.root, ObjectPath):
        return
    trouble = ledger_trouble(url)
    if trouble and (count := len(archive.present())):
        raise WorldError(
            f"{archive.root} holds {count} episodes, and its ledger {shown_url(url)} {trouble}: start where the ledger "
            f"lies, name it with --ledger, or let `factory repair {archive.root}` rebuild it from the episodes"
        )
