"""Core of a gateway: sends its requests through the router's session; ledger operations of its pullers; owner file.

Detects a core that does not reply and reopens the router. `gateway.json` records the run and the gateway that own a
directory, so no gateway uses the episodes of another. Does not interpret requests.

Design: docs/design/protocol.md#a-gateway-has-no-ledger.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import structlog

from coordinator.archive.contract import Archive
from coordinator.protocol.ask import read_reply
from coordinator.protocol.bundles import IncomingBundle
from coordinator.protocol.node import ZenohNode
from coordinator.protocol.relay import Archived, ExtendLease, Inventory, InventoryReply, Refused
from coordinator.transfer.contract import ValidatedBundle
from schemas.base import Model
from schemas.dataset.rows import BundleReceipt
from schemas.errors import TransientError, UsageError, WorldError
from schemas.protocol.keys import Verb, verb_key
from schemas.protocol.messages import Ack, cut_detail
from schemas.storage.disk import replacing
from schemas.support.log_limit import Repeated

_ANY_RUN = "*"
_TIMEOUT_S = 5.0
_PAUSE_S = 0.5
_REOPEN_S = 10.0
R = TypeVar("R", bound=Model)
log = structlog.get_logger(__name__)


class CoreLink:
    """Request client of a gateway.

    Args:
        node: zenoh session of the gateway.
        name: name of the gateway; with TLS the common name of its certificate.
    """

    def __init__(self, node: ZenohNode, name: str) -> None:
        self._node = node
        self._name = name
        self.run = _ANY_RUN
        """Name of the run in the request keys; the wildcard `*` until it is known."""
        self._heard = self._opened = time.monotonic()
        self._reconnecting = threading.Lock()
        self._away = Repeated(log, "core_unreachable")

    @property
    def silence_s(self) -> float:
        """Time since the last reply of the core, or since the start, seconds."""
        return time.monotonic() - self._heard

    def ask(self, verb: Verb, message: Model, kind: type[R]) -> R:
        """Sends a request and returns the reply.

        Raises:
            TransientError: no reply arrived; the core may have processed the request, so repeat it unchanged.
            WorldError: the core refuses the request, or several cores reply.
        """
        key = verb_key(self.run, self._name, verb)
        replies = list(self._node.ask(key, message.model_dump_json(), _TIMEOUT_S))
        if not replies:
            self._reconnect()
            raise TransientError(
                f"the coordinator does not answer request `{verb}` of gateway {self._name}; the request is repeated"
            )
        if len(replies) > 1:
            raise WorldError(
                f"{len(replies)} coordinators answer gateway {self._name}; give --connect endpoints of one run only"
            )
        self._heard = time.monotonic()
        self._away.succeed()
        return read_reply(replies[0], kind, "the coordinator")

    def request_until_reply(self, verb: Verb, message: Model, kind: type[R], stop: threading.Event) -> R:
        """Repeats a request until the core replies.

        Raises:
            TransientError: `stop` was set before the core replied.
            WorldError: the core refuses the request.
        """
        while True:
            try:
                return self.ask(verb, message, kind)
            except TransientError:
                if stop.wait(_PAUSE_S):
                    raise

    def _reconnect(self) -> None:
        """Reopens the router after a long time without replies: a link may be half-open, or zenoh may not retry."""
        with self._reconnecting:
            if time.monotonic() - max(self._heard, self._opened) < _REOPEN_S:
                return
            self._away.fail(f"no answer for {self.silence_s:.0f} s", remedy="none needed; the gateway reconnects")
            try:
                self._node.reopen()
            except WorldError as error:
                raise TransientError(str(error)) from error
            self._opened = time.monotonic()


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

    def keep(self, bundles: Sequence[IncomingBundle], seconds: float) -> Sequence[bool]:
        requests = (ExtendLease(lease=bundle.lease, seconds=seconds) for bundle in bundles)
        return [self._core.ask(Verb.HOLD, request, Ack).accepted for request in requests]

    def is_recorded(self, index: int) -> bool:
        size = self._archive.path_of(index).stat().st_size
        request = Inventory(first=index, last=index, files=((index, size),))
        strays = self._core.ask(Verb.INVENTORY, request, InventoryReply).strays
        return all(stray.index != index for stray in strays)

    def record_archived(self, bundles: Sequence[ValidatedBundle]) -> Sequence[bool]:
        """See `LedgerClient`. Repeats each request until the core replies, because the file is already durable."""
        return [self._record(bundle, receipt) for bundle, receipt, _ in bundles]

    def _record(self, bundle: IncomingBundle, receipt: BundleReceipt) -> bool:
        report = Archived.model_validate({"summary": receipt, "lease": bundle.lease})
        return self._core.request_until_reply(Verb.ARCHIVED, report, Ack, self._stop).accepted

    def refuse(self, bundle: IncomingBundle, detail: str, *, is_false: bool = False) -> None:  # noqa: ARG002 - always false
        self._core.ask(
            Verb.REFUSED,
            Refused(sid=bundle.sid, lease=bundle.lease, detail=cut_detail(detail)),
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
        content = json.loads((root / OWNER_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(
            f"{root / OWNER_FILE} cannot be read: {error}; give the --out of a gateway, or a new directory"
        ) from error
    if content != {"run": run, "gateway": gateway}:
        raise UsageError(
            f"{root} belongs to {content}, not to gateway {gateway!r} of run {run!r}: choose another --out or --name"
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
