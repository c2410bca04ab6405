"""Implements the ledger operations of a gateway's pullers as requests to the core. Stores no state."""

from __future__ import annotations

import threading

from coordinator.archive.contract import Archive
from coordinator.gateway.core_link import CoreLink
from coordinator.protocol.protocol import Pull
from coordinator.protocol.relay import Archived, Hold, Inventory, InventoryReply, Refused
from schemas.dataset import BundleReceipt
from schemas.keys import Verb
from schemas.wire import Ack, cut_detail

__all__ = ["RemoteLedgerClient"]


class RemoteLedgerClient:
    """`LedgerClient` that accesses the ledger of the core.

    Args:
        core: request client of the core.
        archive: archive of the gateway.
        stop: event that ends waiting for a reply.
    """

    def __init__(self, core: CoreLink, archive: Archive, stop: threading.Event) -> None:
        self._core = core
        self._archive = archive
        self._stop = stop

    def keep(self, pull: Pull, seconds: float) -> bool:
        """See `LedgerClient`."""
        return self._core.ask(Verb.HOLD, Hold(lease=pull.lease, seconds=seconds), Ack).accepted

    def is_owned(self, index: int) -> bool:
        """See `LedgerClient`."""
        size = self._archive.path_of(index).stat().st_size
        told = Inventory(first=index, last=index, files=((index, size),))
        strays = self._core.ask(Verb.INVENTORY, told, InventoryReply).strays
        return all(stray.index != index for stray in strays)

    def own(self, pull: Pull, receipt: BundleReceipt) -> bool:
        """See `LedgerClient`. Repeats the request until the core replies, because the file is already durable."""
        told = Archived.model_validate({"summary": receipt, "lease": pull.lease})
        return self._core.insist(Verb.ARCHIVED, told, Ack, self._stop).accepted

    def refuse(self, pull: Pull, detail: str) -> None:
        """See `LedgerClient`."""
        self._core.ask(
            Verb.REFUSED,
            Refused(sid=pull.sid, lease=pull.lease, detail=cut_detail(detail)),
            Ack,
        )
