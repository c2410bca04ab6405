"""Defines the messages between a gateway and its core: orders, results and inventories. Contains no behaviour.

Every message is idempotent. The request key contains the name of the gateway, so access control can compare it with the
certificate.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import FailFast, Field

from schemas.base import Bytes, Line, Model, Ordinal, Sha256, Text
from schemas.dataset.rows import EpisodeSummary
from schemas.job import Job
from schemas.protocol.administration import Hosts
from schemas.protocol.messages import PROTOCOL, Detail, Lease, ProtocolNumber, RouterId, SessionId, Version
from schemas.scene import MAX_INSTANCES, Target

MAX_FILES, MAX_LOST, MAX_ORDERS = 1000, 1000, 64
"""Maximum numbers of files per inventory, of lost episodes per reply and of orders per reply."""


class Join(Model):
    """Request of a gateway to join a run; bundles announced via its router are assigned to it from then on."""

    version: Version
    """Version of minivla-factory."""
    protocol: ProtocolNumber = PROTOCOL
    """Version of the messages of the gateway."""
    router: RouterId
    """zenoh id of the gateway's router."""


class JoinReply(Model):
    """Reply to `Join`: identity of the run."""

    run: Line
    """Name of the run."""
    plan_digest: Sha256
    """Digest of its plan."""


class OrdersRequest(Model):
    """Request of a gateway for orders."""

    router: RouterId
    """zenoh id of the gateway's router."""
    most: Annotated[int, Field(ge=0, le=MAX_ORDERS)]
    """Maximum number of orders in the reply."""
    busy: Hosts = ()
    """Hosts from which the gateway is already pulling enough bundles."""


class RelayOrder(Model):
    """Bundle to pull, with the data that its validation needs."""

    lease: Lease
    """Lease of the job."""
    sid: SessionId
    """Session id of the worker."""
    sha256: Sha256
    """Announced SHA-256."""
    size: Annotated[Bytes, Field(ge=1)]
    """Announced size, bytes."""
    job: Job
    """Job of the bundle."""
    candidates: Annotated[tuple[Target, ...], Field(min_length=1, max_length=MAX_INSTANCES)]
    """Targets of the compiled scene that the episode may have."""


class Orders(Model):
    """Reply to `OrdersRequest`. Each order is sent once, and again after the worker repeats the announcement."""

    orders: Annotated[tuple[RelayOrder, ...], Field(max_length=MAX_ORDERS)] = ()
    """Bundles to pull."""
    finished: bool = False
    """Whether the run is finished, so the gateway will get no more orders unless jobs are queued again."""


class ExtendLease(Model):
    """Request to extend a lease; the reply states whether the lease is in force."""

    lease: Lease
    """Lease to extend."""
    seconds: Annotated[float, Field(gt=0, le=600)]
    """Least remaining duration, seconds."""


class Archived(Model):
    """Report of an episode that is validated and durable at the gateway; the reply states whether it was recorded."""

    summary: EpisodeSummary
    """Row of the episode."""
    lease: Lease | None
    """Lease of the bundle; `None` for a file that was found at the start of the gateway."""


class Refused(Model):
    """Report of a bundle that failed validation."""

    sid: SessionId
    """Session id of the worker."""
    lease: Lease
    """Lease of the bundle."""
    detail: Detail
    """Reason of the failure."""


class Inventory(Model):
    """Files of a gateway with episode numbers from `first` to `last`."""

    first: Ordinal
    """First episode number of the range."""
    last: Ordinal
    """Last episode number of the range."""
    files: Annotated[tuple[tuple[Ordinal, Bytes], ...], Field(max_length=MAX_FILES), FailFast()]
    """Episode number and size (bytes) of each file."""
    is_new: bool = False
    """Whether the directory was just created. The core then refuses if it has records of the gateway, so no
    episode is marked as lost."""


class UnrecordedFile(Model):
    """File of a gateway without a record in the ledger."""

    index: Ordinal
    """Episode number."""
    why: Text
    """Reason why the ledger has no record of the file."""
    job: Job | None = None
    """Job that an intact file may be adopted for; `None` if the ledger does not need the file."""
    candidates: Annotated[tuple[Target, ...], Field(max_length=MAX_INSTANCES)] = ()
    """Targets that the episode may have."""


class InventoryReply(Model):
    """Reply to `Inventory`."""

    strays: Annotated[tuple[UnrecordedFile, ...], Field(max_length=2 * MAX_FILES)] = ()
    """Files without a record at the gateway."""
    lost: Annotated[tuple[Ordinal, ...], Field(max_length=MAX_LOST)] = ()
    """Recorded episodes whose file is missing or has a different size; they are collected again. A reply with
    `MAX_LOST` episodes is incomplete and lists no strays: the gateway repeats the inventory."""
