"""Options of a coordinator: endpoints, ledger, settings, and parts that tests replace. Opens nothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import datetime

from coordinator.clock import seconds_since_boot, utc_now
from coordinator.expansion.draw import EvalJobs
from coordinator.protocol.protocol import FindStates, simulate_all
from coordinator.protocol.tls import Guard
from coordinator.settings import CoordinatorSettings
from coordinator.transfer.contract import BundleValidator, FindLocalBundle, no_local_bundle
from schemas.dataset.meta import GateOutcome
from schemas.dataset.run_shard import RunShard
from schemas.protocol.messages import Hello
from schemas.storage.object_path import ObjectPath

DEFAULT_LISTEN = ("tcp/127.0.0.1:7447",)


@dataclass(frozen=True)
class CoordinatorOptions:
    """Options of a coordinator in addition to its directory, plan and scenes."""

    listen: Sequence[str] = DEFAULT_LISTEN
    """Zenoh endpoints; port 0 selects a free port."""
    hosts: Sequence[str] = ()
    """Names or addresses of this host for workers, which replace wildcards in endpoints; by default the host's name."""
    ledger_url: str | None = None
    """URL of the ledger; by default `ledger.db` in the directory."""
    settings: CoordinatorSettings = field(default_factory=CoordinatorSettings)
    """Operational settings, which do not affect the contents of the dataset."""
    guard: Guard | None = None
    """TLS credentials and admission list; `None` admits every peer that can connect."""
    checker: BundleValidator | None = None
    """Validator of bundles, closed with the coordinator; by default one sandboxed child process per puller."""
    clock: Callable[[], datetime] = utc_now
    """Wall clock; tests provide one to let leases expire."""
    elapsed: Callable[[], float] = seconds_since_boot
    """Monotonic clock, seconds, to detect changes of the wall clock."""
    gate: Sequence[GateOutcome] = ()
    """Results of the gate before a new run, recorded in the dataset's metadata."""
    store: ObjectPath | None = None
    """Root of the dataset in object storage; `None` for a dataset in a directory."""
    take_over: bool = False
    """Whether to take over a dataset in object storage from another state directory, whose coordinator has ended."""
    shard: RunShard | None = None
    """Shard of the run that the coordinator generates; `None` for the whole run."""
    evaluation: EvalJobs | None = None
    """Jobs of an evaluation, which replace the plan's draws; their results are archived without episode tables."""
    find_states: FindStates = simulate_all
    """Function that returns the states recording of a job."""
    connect: Sequence[str] = ()
    """Endpoints of other coordinators, whose workers may also execute jobs of this one."""
    on_joined: Callable[[Hello], None] = lambda _hello: None
    """Callback after the first registration of a worker; must not block."""
    find_local_bundle: FindLocalBundle = no_local_bundle
    """Function that finds bundles of workers on this machine, to avoid the transfer over the network."""
