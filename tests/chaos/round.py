"""Runs one round with injected faults and checks its dataset against that of an undisturbed reference run."""

from __future__ import annotations

import random
import shutil
import threading
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from schemas.terms import Recording
from tests.chaos.cluster import LARGE_CRASH_BUDGET, ChaosCluster, ClusterCommands
from tests.chaos.disk import Disk
from tests.chaos.fault_span import FaultSpan
from tests.chaos.faults import FAULTS, possible
from tests.chaos.hostile_peer import HostilePeer
from tests.chaos.peers import Peers, effects_of_peers, preload_strikes
from tests.chaos.tally import Tally
from tests.chaos.verdict import digest_of, gather_problems, violations_of

_DISK_MB = 64
_START_DELAY_S = 2.0
_SHORT_DISK_S = (0.3, 2.0)
"""Shortest and longest time for which a disk is full or slow, seconds."""
_TICK_S = 0.05


class Stopped(Exception):
    """The campaign was stopped; the round is not counted."""


@dataclass(frozen=True)
class FaultLoad:
    """Faults to inject in a round."""

    workers: int
    """Number of hosts."""
    faults: int
    """Maximum number of faults; fewer when the run finishes earlier."""
    pause_s: tuple[float, float] = (0.1, 0.7)
    """Shortest and longest pause between two faults, seconds."""
    peers: Peers | None = None
    """A hostile peer and a faulty host in addition to the workers; `None` for none."""


def reference_digest(commands: ClusterCommands, root: Path) -> str:
    """Returns the digest of the dataset that one worker generates without faults."""
    root.mkdir()
    with ChaosCluster(root, commands, 1) as cluster:
        deadline = time.monotonic() + commands.longest_s
        while len(cluster.archived()) < commands.episodes:
            assert time.monotonic() < deadline, cluster.log.read_text()[-4000:]
            cluster.tend()
            time.sleep(_TICK_S)
        cluster.end()
        digest = digest_of(cluster)
    shutil.rmtree(root)
    return digest


def run_round(
    commands: ClusterCommands,
    root: Path,
    load: FaultLoad,
    seed: int,
    reference: str,
    stop: threading.Event | None = None,
) -> Tally:
    """Runs one round and returns its faults and violations.

    Args:
        commands: commands that start the processes.
        root: working directory; removed if there are no violations, otherwise kept with log and ledger as `evidence*`.
        load: faults to inject.
        seed: seed of the choice of faults; their timing depends on the machine.
        reference: expected digest of the dataset.
        stop: ends the round early.

    Raises:
        Stopped: `stop` was set.
    """
    root.mkdir()
    with ExitStack() as stack:
        disk = stack.enter_context(Disk(root, _DISK_MB))
        rng = random.Random(seed)
        damage = rng.choice(load.peers.damages) if load.peers is not None else 0.0
        cluster = stack.enter_context(ChaosCluster(root, commands, load.workers, disk, damage))
        hostile = _hostile_peer(cluster, load, random.Random(f"{seed} hostile"), stack)
        tally = Tally(missing=disk.missing, rounds=Counter({_topology(commands, load): 1}))
        started = time.monotonic()
        spans = _inject_faults(cluster, disk, load, rng, stop or threading.Event())
        if len(cluster.archived()) < commands.episodes:
            cluster.violations.append(
                f"{len(cluster.archived())} of {commands.episodes} episodes after {commands.longest_s:g} s"
            )
            shutil.copy(cluster.out / "ledger.db", root / "evidence-then.db")
        if hostile is not None:
            hostile.stop()
        cluster.end()
        tally.seconds = time.monotonic() - started
        if hostile is not None:
            hostile.settle()
            cluster.violations += hostile.violations
            spans += hostile.acts + effects_of_peers(cluster)
        cluster.violations += gather_problems(cluster)
        cluster.violations += violations_of(cluster)
        digest = digest_of(cluster)
        if digest != reference:
            cluster.violations.append(f"digest {digest}, reference {reference}")
        for kind, span in spans:
            (tally.faults if span.effects else tally.without_effect)[kind] += 1
        tally.episodes = len(cluster.archived())
        tally.outcomes = cluster.outcomes()
        tally.restarts = cluster.restarts
        tally.violations = [f"seed {seed}: {text}" for text in cluster.violations]
        if cluster.violations:
            shutil.copy(cluster.out / "ledger.db", root / "evidence.db")
            shutil.copy(cluster.log, root / "evidence.log")
    if not tally.violations:
        shutil.rmtree(root)
    return tally


def _inject_faults(
    cluster: ChaosCluster, disk: Disk, load: FaultLoad, rng: random.Random, stop: threading.Event
) -> list[tuple[str, FaultSpan]]:
    """Injects faults until every episode is archived or time is up, then ends all faults."""
    kinds, spans = possible(cluster), list[tuple[str, FaultSpan]]()
    deadline = time.monotonic() + cluster.commands.longest_s
    has_strikes = load.peers is None
    next_fault, disk_recovers_at = float("inf"), float("inf")
    while len(cluster.archived()) < cluster.commands.episodes and time.monotonic() < deadline:
        now = time.monotonic()
        if next_fault == float("inf") and cluster.leased():
            next_fault = now + _START_DELAY_S  # processes import for seconds, in which a fault has no effect
        if now > disk_recovers_at:
            disk.clear()
            disk_recovers_at = float("inf")
        if len(spans) < load.faults and now > next_fault:
            kind = rng.choice(kinds)
            span = FAULTS[kind](cluster, rng.randrange(load.workers), rng)
            if span is not None:
                spans.append((kind, span))
                disk_recovers_at = (
                    min(disk_recovers_at, now + rng.uniform(*_SHORT_DISK_S))
                    if kind.endswith("disk")
                    else disk_recovers_at
                )
                next_fault = time.monotonic() + rng.uniform(*load.pause_s)
        has_strikes = has_strikes or preload_strikes(cluster, rng)
        cluster.tend()
        if stop.wait(_TICK_S):
            raise Stopped
    disk.clear()
    cluster.tend(at_once=True)
    return spans


def _hostile_peer(cluster: ChaosCluster, load: FaultLoad, rng: random.Random, stack: ExitStack) -> HostilePeer | None:
    if load.peers is None:
        return None
    return stack.enter_context(HostilePeer(cluster, rng, load.peers.pause_s))


def _topology(commands: ClusterCommands, load: FaultLoad) -> str:
    where = f"with {commands.gateways} gateways" if commands.gateways else "without gateways"
    budget = f" and a budget of {commands.crashes} crashes" if commands.crashes < LARGE_CRASH_BUDGET else ""
    states = " of states" if commands.record is Recording.STATES else ""
    return where + (" with peers" if load.peers is not None else "") + budget + states
