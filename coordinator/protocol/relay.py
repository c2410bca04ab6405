"""What a gateway and its core say to each other: bundles to pull, what became of them, what lies where. Values only.

Every message is idempotent. The gateway is named by the key it asks under, so that its certificate binds it.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import FailFast, Field

from schemas.base import Bytes, Line, Model, Ordinal, Sha256, Text
from schemas.dataset import EpisodeSummary
from schemas.job import Job
from schemas.scene import Target
from schemas.wire import Detail, Hosts, Lease, RouterId, SessionId, Version

__all__ = [
    "MAX_FILES",
    "MAX_LOST",
    "MAX_ORDERS",
    "Archived",
    "Duty",
    "Hold",
    "Inventory",
    "InventoryReply",
    "Join",
    "JoinReply",
    "Orders",
    "Refused",
    "RelayOrder",
    "Stray",
]

MAX_FILES, MAX_LOST, MAX_ORDERS = 1000, 1000, 64


class Join(Model):
    """A gateway looks for the run it is to serve; from now on what is announced via its router is its own to pull."""

    version: Version
    """Of minivla-factory."""
    router: RouterId


class JoinReply(Model):
    """Which run that is."""

    run: Line
    plan_digest: Sha256


class Duty(Model):
    """A gateway asks what to pull; bundles of workers that reach the core through it are its own."""

    router: RouterId
    most: Annotated[int, Field(ge=0, le=MAX_ORDERS)]
    """Orders it can take now."""
    busy: Hosts = ()
    """Hosts of which it has bundles enough."""


class RelayOrder(Model):
    """A bundle to pull, with all that validating it needs."""

    lease: Lease
    sid: SessionId
    sha256: Sha256
    size: Annotated[Bytes, Field(ge=1)]
    job: Job
    target: Target


class Orders(Model):
    """What to pull; given out once, and again when the worker announces it again."""

    orders: Annotated[tuple[RelayOrder, ...], Field(max_length=MAX_ORDERS)] = ()


class Hold(Model):
    """Lets a lease last at least so long from now; the answer says whether it is in force."""

    lease: Lease
    seconds: Annotated[float, Field(gt=0, le=600)]


class Archived(Model):
    """An episode is validated and durable in the gateway's directory; the answer says whether the ledger owns it."""

    summary: EpisodeSummary
    lease: Lease | None
    """It was pulled under; `None` for a file that was found when the gateway started."""


class Refused(Model):
    """A bundle that is not what its job asked for."""

    sid: SessionId
    lease: Lease
    detail: Detail


class Inventory(Model):
    """The files of a gateway whose numbers lie between two bounds, both included."""

    first: Ordinal
    last: Ordinal
    files: Annotated[tuple[tuple[Ordinal, Bytes], ...], Field(max_length=MAX_FILES), FailFast()]
    """Episode and bytes."""
    is_new: bool = False
    """Whether its directory was just made: then nothing can be there by right, and nothing is given up either."""


class Stray(Model):
    """A file that the ledger does not own at this gateway."""

    index: Ordinal
    why: Text
    job: Job | None = None
    """What a sound file would be of, when the ledger still wants one; nobody else wants it without."""
    target: Target | None = None


class InventoryReply(Model):
    """What the ledger says to an inventory."""

    strays: Annotated[tuple[Stray, ...], Field(max_length=2 * MAX_FILES)] = ()
    lost: Annotated[tuple[Ordinal, ...], Field(max_length=MAX_LOST)] = ()
    """Episodes the ledger owned there whose file is gone or of another size; they are made anew. With `MAX_LOST` of
    them the answer is not complete and lists no strays: the gateway tells the same again."""
