"""How one coordinator runs: endpoints, ledger, numbers, and what tests replace. Opens nothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import datetime

from coordinator.clock import seconds_since_boot, utc_now
from coordinator.expansion.evaluation import EvalJobs
from coordinator.protocol.tls import Guard
from coordinator.settings import CoordinatorSettings
from coordinator.transfer.puller import Judge, Nearby, nothing_nearby
from schemas.dataset_meta import GateOutcome
from schemas.storage.object_path import ObjectPath

__all__ = ["DEFAULT_LISTEN", "CoordinatorOptions"]

DEFAULT_LISTEN = ("tcp/127.0.0.1:7447",)


@dataclass(frozen=True)
class CoordinatorOptions:
    """Everything about a coordinator beside its directory, plan and scenes."""

    listen: Sequence[str] = DEFAULT_LISTEN
    """Zenoh endpoints; port 0 takes a free one."""
    ledger_url: str | None = None
    """Another database than `ledger.db` in the directory."""
    settings: CoordinatorSettings = field(default_factory=CoordinatorSettings)
    """Numbers that change no byte of the dataset."""
    guard: Guard | None = None
    """Certificates and who is admitted; `None` admits every peer."""
    checker: Judge | None = None
    """Judges bundles and is closed with the coordinator; by default sandboxed children, one a puller."""
    clock: Callable[[], datetime] = utc_now
    """The time; tests let leases run out with it."""
    elapsed: Callable[[], float] = seconds_since_boot
    """Seconds that pass evenly; a clock that was set is noticed by them."""
    gate: Sequence[GateOutcome] = ()
    """What a pilot found before a new run; goes into the dataset's description."""
    store: ObjectPath | None = None
    """Where the dataset is stored, when in object storage."""
    evaluation: EvalJobs | None = None
    """Jobs in the place of the plan's draws; their results are kept, and no tables of episodes are written."""
    connect: Sequence[str] = ()
    """Endpoints of other coordinators, whose workers may work for this one too."""
    nearby: Nearby = nothing_nearby
    """Finds bundles of workers on this machine, which then need not come over the network."""
