"""Messages between workers and the coordinator: every verb is idempotent and carries the lease it speaks for.

An empty reply and a time-out both mean *unknown*: the caller repeats the same message (docs/design/protocol.md#verbs).
"""

from __future__ import annotations

from datetime import datetime
from enum import StrEnum
from typing import Annotated

from pydantic import FailFast, Field

from schemas.base import Bytes, Count, Line, Model, NonNegative, Ordinal, Positive, RowId, Sha256, Text
from schemas.job import Job
from schemas.plan import MAX_EPISODES
from schemas.terms import FailReason

__all__ = [
    "HOST_PATTERN",
    "MAX_ATTACHMENT_BYTES",
    "MAX_DETAIL_CHARS",
    "MAX_ERRAND_CHARS",
    "MAX_HOSTS",
    "MAX_INDICES",
    "MAX_LEASES",
    "MAX_MESSAGE_BYTES",
    "PROTOCOL",
    "Ack",
    "AdminAction",
    "AdminReply",
    "AdminRequest",
    "Attachment",
    "Beat",
    "BeatReply",
    "Claim",
    "ClaimReply",
    "Done",
    "Fail",
    "Hello",
    "HelloReply",
    "HostStatus",
    "Lease",
    "LeaseProgress",
    "Ping",
    "Progress",
    "Refusal",
    "Trade",
    "WorkerStatus",
    "cut_detail",
]

PROTOCOL = 1
"""Version of keys and messages; it stands in every key."""
MAX_MESSAGE_BYTES = 1 << 20
MAX_ERRAND_CHARS = 1 << 18
MAX_LEASES = 256
"""Most leases in simulation, and as many in the spool, of one beat; a host that has more beats several times."""
MAX_DETAIL_CHARS = 2000
"""Of what a failure or a refusal says."""
MAX_INDICES = 100_000
"""Most episodes that one admin request names."""
MAX_HOSTS = 10_000
_MAX_SESSIONS = 100_000
_MAX_GROUPS = 1000
MAX_ATTACHMENT_BYTES = 1 << 30

SessionId = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9._-]{0,79}$")]
HOST_PATTERN = r"^[a-z0-9](?:[a-z0-9-]{0,46}[a-z0-9])?$"
"""Name of a host; it has no dot, which ends it in a session id."""
HostName = Annotated[str, Field(pattern=HOST_PATTERN)]
Token = Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]
Version = Annotated[str, Field(pattern=r"^[!-~]{0,40}$")]
Detail = Annotated[str, Field(max_length=MAX_DETAIL_CHARS, pattern=r"^[^\x00]*$")]
"""What a failure or a refusal says; PostgreSQL stores no NUL."""
RouterId = Annotated[str, Field(pattern=r"^[0-9a-f]{1,32}$")]
"""Zenoh's id of a session that others connect to, of a gateway for one."""


def cut_detail(text: str) -> str:
    """Returns a text as a detail may be: without NUL, and a long one without its end."""
    return text.replace("\0", "")[:MAX_DETAIL_CHARS]


class Lease(Model):
    """The right to work on a job: all three must match what the ledger holds."""

    job_id: RowId
    """Row of the ledger."""
    fence: Ordinal
    """Rises at every claim of the job; an older one is stale."""
    token: Token
    """Invented by the worker, so that a repeated claim finds its job again."""


Leases = Annotated[tuple[Lease, ...], Field(max_length=MAX_LEASES), FailFast()]


class Trade(StrEnum):
    """What the jobs of a run are, and so which program carries them out."""

    COLLECTION = "collection"  # an expert drives, and successes are archived
    EVALUATION = "evaluation"  # a policy drives, and every result is archived


class Hello(Model):
    """A worker introduces itself, at start and after every reconnect."""

    sid: SessionId
    host: SessionId
    slots: Annotated[int, Field(ge=1, le=4096)]
    """Simulations it runs at a time."""
    version: Version
    """Of minivla-factory."""


class HelloReply(Model):
    """What a worker must know before it claims."""

    run: Line
    version: Version
    lease_ttl_s: Positive
    trade: Trade = Trade.COLLECTION


class Claim(Model):
    """Asks for one job under a token of the worker's choice."""

    sid: SessionId
    token: Token


class Attachment(Model):
    """A file that an errand needs; fetched by its digest as a compiled scene is."""

    sha256: Sha256
    size: Annotated[int, Field(ge=1, le=MAX_ATTACHMENT_BYTES)]


class ClaimReply(Model):
    """A job with its lease, or how long to wait before asking again."""

    job: Job | None = None
    lease: Lease | None = None
    errand: Annotated[str, Field(max_length=MAX_ERRAND_CHARS)] | None = None
    """What a run of errands tells the simulation beside the job; nobody in between reads it."""
    attachment: Attachment | None = None
    retry_after_s: NonNegative = 0.0
    finished: bool = False
    """Whether every job has reached its end, so that the worker may leave."""


class LeaseProgress(Model):
    """What a simulation has done under its lease."""

    lease: Lease
    step: Count
    """Steps simulated so far in this attempt."""


class Beat(Model):
    """One heartbeat for all of a host's work."""

    sid: SessionId
    live: Annotated[tuple[LeaseProgress, ...], Field(max_length=MAX_LEASES), FailFast()] = ()
    """Leases in simulation."""
    spool: Leases = ()
    """Leases whose bundle waits in the spool."""
    via: RouterId | None = None
    """Zenoh's id of the router the worker is connected to; a gateway of that id pulls its bundles."""


class BeatReply(Model):
    """What the coordinator holds against the beat."""

    lost: Leases = ()
    """Leases that are no longer theirs: stop simulating."""
    drop: Leases = ()
    """Bundles that are not wanted any more, archived or stale: delete them."""
    waiting: Leases = ()
    """Bundles that are announced and will be pulled: they need not be announced again."""
    drain: bool = False
    """Whether to claim no more and leave when done."""
    finished: bool = False
    """Whether every job has reached its end; a worker whose simulations pause or start learns it here."""


class Done(Model):
    """Announces a bundle that can be pulled; metadata only."""

    sid: SessionId
    lease: Lease
    sha256: Sha256
    size: Annotated[Bytes, Field(ge=1)]
    """Of the bundle."""
    via: RouterId | None = None
    """As in `Beat`."""


class Fail(Model):
    """Reports an attempt that brought no episode."""

    sid: SessionId
    lease: Lease
    reason: FailReason
    detail: Detail = ""
    """Measured values, in words."""
    steps: Count = 0
    """Steps simulated before the end."""
    seconds: NonNegative = 0.0
    """Wall time spent."""


class Ping(Model):
    """Asks whether a coordinator is there; its answer is an `Ack` that says nothing of the run."""


class Ack(Model):
    """Answer to `done` and `fail`, whether the lease was still theirs; to `ping` always true."""

    accepted: bool


class Refusal(Model):
    """Answer to a message that cannot be served, with the reason."""

    error: Text


Hosts = Annotated[tuple[HostName, ...], Field(max_length=MAX_HOSTS), FailFast()]


class AdminAction(StrEnum):
    """What an operator may do to a run."""

    RETRY = "retry"  # put failed or cancelled episodes back into the queue
    CANCEL = "cancel"  # give up episodes that have not ended
    DRAIN = "drain"  # let every worker finish what it has and leave
    RELEASE = "release"  # give jobs again to hosts that are barred


class AdminRequest(Model):
    """An operator's wish; repeating it changes nothing more."""

    action: AdminAction
    indices: Annotated[tuple[Ordinal, ...], Field(max_length=MAX_INDICES), FailFast()] = ()
    """Episodes meant, by number; empty means every one the action fits."""
    hosts: Hosts = ()
    """Hosts meant; empty means every one the action fits."""


class AdminReply(Model):
    """What came of an operator's wish."""

    changed: Annotated[tuple[Count, ...], Field(max_length=MAX_EPISODES)]
    """Episodes that changed their state."""
    refused: Annotated[dict[Count, Line], Field(max_length=MAX_INDICES)] = Field(default_factory=dict)
    """Episodes named by number that could not, with the reason."""
    hosts: Hosts = ()
    """Hosts that changed their state."""
    refused_hosts: Annotated[dict[HostName, Line], Field(max_length=MAX_HOSTS)] = Field(default_factory=dict)
    """Hosts named that could not, with the reason."""


class WorkerStatus(Model):
    """One worker as the ledger knows it."""

    sid: Line
    host: Line
    slots: Count
    leased: Count
    """Jobs it holds now."""
    archived: Count
    """Episodes it has brought so far."""
    last_beat: datetime
    alive: bool
    """Whether it was heard of within a lease."""


class HostStatus(Model):
    """A host whose attempts were refused or crashed, as the ledger knows it."""

    host: Line
    strikes: Count
    """Failures that count against it, less its successes."""
    resumes_at: datetime
    """It gets no job before."""
    barred_at: datetime | None
    """Since when it gets no job until an operator releases it; `None` where it is not barred."""
    reason: Text
    """The last failure that counted."""


Counts = Annotated[dict[Line, Count], Field(max_length=_MAX_GROUPS)]
Groups = Annotated[dict[Line, Counts], Field(max_length=_MAX_GROUPS)]


class Progress(Model):
    """Where a run stands, from the ledger."""

    run: Line
    planned: Count
    """Episodes in the plan."""
    jobs: Counts
    """Count by state of the current draw of every episode; adds up to `planned`."""
    by_scene: Groups
    by_tier: Groups
    by_split: Groups
    redrawn: Count
    """Draws given up as hopeless and replaced."""
    attempts: Counts
    """Attempts by outcome: `success` and every fail reason."""
    workers: Annotated[tuple[WorkerStatus, ...], Field(max_length=_MAX_SESSIONS)]
    hosts: Annotated[tuple[HostStatus, ...], Field(max_length=_MAX_SESSIONS)] = ()
    """Hosts that pause or are barred."""
    by_gateway: Counts = Field(default_factory=dict)
    """Archived episodes that lie at a gateway, by its name; those not counted here lie in the core's directory."""
    episodes_per_hour: NonNegative | None
    """Over the last ten minutes of archiving; `None` before the second episode."""
    eta_s: NonNegative | None
    """Seconds to the end at that rate; `None` when unknown, 0 when finished."""
    finished: bool
    """Whether no job can change any more without a `retry`."""
    sandbox: Annotated[tuple[Line, ...], Field(max_length=_MAX_GROUPS)] = ()
    """What confined the coordinator's validating processes last, e.g. `seccomp`; empty before the first bundle."""

    @property
    def missing(self) -> int:
        """Planned episodes that are not archived."""
        return self.planned - self.jobs.get("archived", 0)

    @property
    def failures(self) -> dict[str, int]:
        """Failed attempts by reason; a job that its worker gave back unharmed has not failed."""
        return {name: count for name, count in self.attempts.items() if name not in {"success", FailReason.RELEASED}}

    @property
    def given_back(self) -> int:
        """Attempts that were broken off, as by Ctrl-C: their jobs wait again and have lost nothing."""
        return self.attempts.get(FailReason.RELEASED, 0)
