"""Ledger of a gateway: operations of its pullers as requests to the core, and the owner file of its directory.

`gateway.json` records the run and the gateway that own a directory, so no gateway uses the episodes of another.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Sequence
from pathlib import Path

from coordinator.archive.contract import Archive
from coordinator.gateway.core_link import CoreLink
from coordinator.protocol.pulls import Pull
from coordinator.protocol.relay import Archived, ExtendLease, Inventory, InventoryReply, Refused
from coordinator.transfer.contract import Delivery
from schemas.dataset.rows import BundleReceipt
from schemas.errors import UsageError
from schemas.protocol.keys import Verb
from schemas.protocol.messages import Ack, cut_detail
from schemas.storage.disk import replacing

OWNER_FILE = "gateway.json"
"""Name of the file in the directory of a gateway."""


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

    def keep(self, pulls: Sequence[Pull], seconds: float) -> Sequence[bool]:
        """See `LedgerClient`."""
        return [
            self._core.ask(Verb.HOLD, ExtendLease(lease=pull.lease, seconds=seconds), Ack).accepted for pull in pulls
        ]

    def is_owned(self, index: int) -> bool:
        """See `LedgerClient`."""
        size = self._archive.path_of(index).stat().st_size
        told = Inventory(first=index, last=index, files=((index, size),))
        strays = self._core.ask(Verb.INVENTORY, told, InventoryReply).strays
        return all(stray.index != index for stray in strays)

    def own(self, deliveries: Sequence[Delivery]) -> Sequence[bool]:
        """See `LedgerClient`. Repeats each request until the core replies, because the file is already durable."""
        return [self._own(pull, receipt) for pull, receipt, _ in deliveries]

    def _own(self, pull: Pull, receipt: BundleReceipt) -> bool:
        told = Archived.model_validate({"summary": receipt, "lease": pull.lease})
        return self._core.request_until_reply(Verb.ARCHIVED, told, Ack, self._stop).accepted

    def refuse(self, pull: Pull, detail: str, *, is_false: bool = False) -> None:  # noqa: ARG002 - always false
        """See `LedgerClient`."""
        self._core.ask(
            Verb.REFUSED,
            Refused(sid=pull.sid, lease=pull.lease, detail=cut_detail(detail)),
            Ack,
        )


def has_owner(root: Path) -> bool:
    """Returns whether the directory has an owner file."""
    return (root / OWNER_FILE).exists()


def require_owner(root: Path, run: str, gateway: str) -> None:
    """Checks that a directory with an owner file belongs to this run and gateway.

    Raises:
        UsageError: the directory belongs to another run or gateway, or the file cannot be read.
    """
    if not has_owner(root):
        return
    try:
        found = json.loads((root / OWNER_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(
            f"{root / OWNER_FILE} cannot be read: {error}; give the --out of a gateway, or a new directory"
        ) from error
    if found != {"run": run, "gateway": gateway}:
        raise UsageError(
            f"{root} belongs to {found}, not to gateway {gateway!r} of run {run!r}: choose another --out or --name"
        )


def write_owner(root: Path, run: str, gateway: str) -> None:
    """Writes the owner file durably. Does nothing if the file exists.

    Raises:
        WorldError: the file cannot be written.
    """
    if has_owner(root):
        return
    with replacing(root / OWNER_FILE, durable=True) as part:
        part.write_text(json.dumps({"run": run, "gateway": gateway}), encoding="utf-8")
