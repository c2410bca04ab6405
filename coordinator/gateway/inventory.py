"""Reconciles a gateway's directory with the ledger at start: files are kept, offered for adoption or quarantined.

This is the counterpart of `reconcile` in the core, with requests instead of ledger access. The module does not delete
files that could be episodes.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import structlog

from coordinator.archive.directory import DirectoryArchive
from coordinator.gateway.core import CoreLink
from coordinator.protocol.relay import MAX_FILES, MAX_LOST, Archived, Inventory, InventoryReply, UnrecordedFile
from coordinator.transfer.contract import EpisodeValidator
from schemas.bundle import BundleReader
from schemas.errors import InvalidBundle
from schemas.job import Job
from schemas.protocol.keys import Verb
from schemas.protocol.messages import Ack
from schemas.storage.place import FilePlace, local_copy

_LAST = 2**31 - 1

log = structlog.get_logger(__name__)


@dataclass
class DirectoryInventory:
    """Result of the reconciliation, by episode number."""

    kept: int = 0
    """Number of files that the ledger records at this gateway."""
    adopted: list[int] = field(default_factory=list)
    """Episodes that were published and not yet recorded."""
    quarantined: list[int] = field(default_factory=list)
    """Episodes whose files were moved to the quarantine folder."""
    lost: list[int] = field(default_factory=list)
    """Episodes that the ledger recorded at this gateway and whose files are missing; they are collected again."""


def reconcile_directory(
    archive: DirectoryArchive, core: CoreLink, checker: EpisodeValidator, stop: threading.Event, *, is_new: bool
) -> DirectoryInventory:
    """Reconciles a gateway's directory with the ledger.

    Args:
        archive: archive of the gateway, held exclusively.
        core: request client of the core.
        checker: validator of the files to adopt.
        stop: event that ends waiting for the core.
        is_new: whether the directory was just created.

    Raises:
        TransientError: `stop` was set before the core replied, or no bundle can be validated on this machine now.
        WorldError: the ledger records episodes in another directory of this gateway.
    """
    inventory = DirectoryInventory()
    for path in archive.foreign():
        archive.quarantine(path, "its name is not that of an episode")
    present = archive.present()
    for directory_inventory in _inventories(
        {index: path.stat().st_size for index, path in present.items()}, is_new=is_new
    ):
        while (
            len((reply := core.request_until_reply(Verb.INVENTORY, directory_inventory, InventoryReply, stop)).lost)
            == MAX_LOST
        ):
            inventory.lost += reply.lost
        inventory.kept += len(directory_inventory.files) - len(reply.strays)
        inventory.lost += reply.lost
        for stray in reply.strays:
            _settle(stray, present[stray.index], archive, core, checker, stop, inventory)
    log.info(
        "inventory_reconciled",
        kept=inventory.kept,
        adopted=len(inventory.adopted),
        quarantined=len(inventory.quarantined),
        lost=len(inventory.lost),
    )
    return inventory


def _inventories(sizes: dict[int, int], *, is_new: bool) -> Iterator[Inventory]:
    """Yields inventories that cover all episode numbers, each within the size limits of one message."""
    first, rest = 1, iter(sorted(sizes.items()))
    while files := tuple(islice(rest, MAX_FILES)):
        last = files[-1][0]
        yield Inventory(first=first, last=last, files=files, is_new=is_new)
        first = last + 1
    yield Inventory(first=first, last=_LAST, files=(), is_new=is_new)


def _settle(
    stray: UnrecordedFile,
    path: FilePlace,
    archive: DirectoryArchive,
    core: CoreLink,
    checker: EpisodeValidator,
    stop: threading.Event,
    inventory: DirectoryInventory,
) -> None:
    refusal = _offer(stray, path, core, checker, stop)
    if refusal:
        archive.quarantine(path, refusal)
        inventory.quarantined.append(stray.index)
    else:
        inventory.adopted.append(stray.index)


def _offer(
    stray: UnrecordedFile, path: FilePlace, core: CoreLink, checker: EpisodeValidator, stop: threading.Event
) -> str:
    """Validates a file and offers it to the core; returns the reason if it is not adopted, else an empty string."""
    if stray.job is None:
        return stray.why
    try:
        with local_copy(path) as file:
            summary = checker.check(file, _job_of(file, stray.job), stray.candidates)
    except InvalidBundle as error:
        return str(error)
    ack = core.request_until_reply(Verb.ARCHIVED, Archived(summary=summary, lease=None), Ack, stop)
    return "" if ack.accepted else "the core no longer needs it"


def _job_of(path: Path, job: Job) -> Job:
    """Returns the job, with the attempt recorded in the file if that is a later attempt of the same draw."""
    with path.open("rb") as file, BundleReader(file) as bundle:
        recorded = bundle.meta.job
    is_later = recorded.draw == job.draw and recorded.attempt > job.attempt
    return job.model_copy(update={"attempt": recorded.attempt}) if is_later else job
