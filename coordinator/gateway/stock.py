"""What lies in a gateway's directory, told to its core at start: kept, offered for adoption, or set aside.

Like `reconcile` in the core, with the ledger far away. Deletes nothing that could be an episode.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import structlog

from coordinator.archive.directory import DirectoryArchive
from coordinator.gateway.core_link import CoreLink
from coordinator.protocol.relay import MAX_FILES, MAX_LOST, Archived, Inventory, InventoryReply, Stray
from coordinator.transfer.puller import Checker
from schemas.bundle import BundleReader
from schemas.errors import InvalidBundle
from schemas.job import Job
from schemas.keys import Verb
from schemas.wire import Ack

__all__ = ["Stock", "take_stock"]

_LAST = 2**31 - 1

log = structlog.get_logger(__name__)


@dataclass
class Stock:
    """What was found, by episode number."""

    kept: int = 0
    """Files that the ledger owns here."""
    adopted: list[int] = field(default_factory=list)
    """Published, but the core had not been told."""
    quarantined: list[int] = field(default_factory=list)
    lost: list[int] = field(default_factory=list)
    """The ledger owned them here, and their files are gone; they are made anew."""


def take_stock(
    archive: DirectoryArchive, core: CoreLink, checker: Checker, stop: threading.Event, *, is_new: bool
) -> Stock:
    """Brings a gateway's directory and the ledger to agree.

    Args:
        archive: of the gateway, held exclusively.
        core: to ask.
        checker: judges files that are to be adopted.
        stop: ends waiting for the core.
        is_new: whether the directory was just made.

    Raises:
        TransientError: told to stop before the core has answered, or nothing can be judged on this machine now.
        WorldError: the core says that episodes lie in another directory of this gateway.
    """
    stock = Stock()
    for path in archive.foreign():
        archive.quarantine(path, "no episode by its name")
    present = archive.present()
    for told in _inventories({index: path.stat().st_size for index, path in present.items()}, is_new=is_new):
        while len((reply := core.insist(Verb.INVENTORY, told, InventoryReply, stop)).lost) == MAX_LOST:
            stock.lost += reply.lost
        stock.kept += len(told.files) - len(reply.strays)
        stock.lost += reply.lost
        for stray in reply.strays:
            _settle(stray, present[stray.index], archive, core, checker, stop, stock)
    log.info(
        "stock_taken",
        kept=stock.kept,
        adopted=len(stock.adopted),
        quarantined=len(stock.quarantined),
        lost=len(stock.lost),
    )
    return stock


def _inventories(sizes: dict[int, int], *, is_new: bool) -> Iterator[Inventory]:
    """Yields inventories that cover every number there can be, each within the bounds of one message."""
    first, rest = 1, iter(sorted(sizes.items()))
    while files := tuple(islice(rest, MAX_FILES)):
        last = files[-1][0]
        yield Inventory(first=first, last=last, files=files, is_new=is_new)
        first = last + 1
    yield Inventory(first=first, last=_LAST, files=(), is_new=is_new)


def _settle(
    stray: Stray,
    path: Path,
    archive: DirectoryArchive,
    core: CoreLink,
    checker: Checker,
    stop: threading.Event,
    stock: Stock,
) -> None:
    refusal = _offer(stray, path, core, checker, stop)
    if refusal:
        archive.quarantine(path, refusal)
        stock.quarantined.append(stray.index)
    else:
        stock.adopted.append(stray.index)


def _offer(stray: Stray, path: Path, core: CoreLink, checker: Checker, stop: threading.Event) -> str:
    """Offers a file to the core if it is what its job asks for; returns why not, or nothing when it is adopted."""
    if stray.job is None:
        return stray.why
    try:
        summary = checker.check(path, _job_of(path, stray.job), stray.target)
    except InvalidBundle as error:
        return str(error)
    ack = core.insist(Verb.ARCHIVED, Archived(summary=summary, lease=None), Ack, stop)
    return "" if ack.accepted else "the core does not want it any more"


def _job_of(path: Path, job: Job) -> Job:
    """Returns the job at the attempt that a file says it is of, where that is a later one of the same draw."""
    with path.open("rb") as file, BundleReader(file) as bundle:
        said = bundle.meta.job
    is_later = said.draw == job.draw and said.attempt > job.attempt
    return job.model_copy(update={"attempt": said.attempt}) if is_later else job
