"""Defines the faults of a campaign, each in one entry of `FAULTS`.

A fault is injected only into a process that is in the required state, such as running a job. Each function of a fault
returns a span, which records the effects.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping

from schemas.terms import Recording
from tests.chaos.cluster import LARGE_CRASH_BUDGET, LEASE_S, ChaosCluster
from tests.chaos.fault_span import FaultSpan

Fault = Callable[[ChaosCluster, int, random.Random], FaultSpan | None]


def _fill_disk(cluster: ChaosCluster, _number: int, _rng: random.Random) -> FaultSpan | None:
    if cluster.disk is None:
        return None
    cluster.note_full_disk()
    return cluster.disk.fill()


def _slow_disk(cluster: ChaosCluster, _number: int, rng: random.Random) -> FaultSpan | None:
    return cluster.disk.slow(rng.randint(20, 300)) if cluster.disk is not None else None


def _of(cluster: ChaosCluster, number: int) -> int:
    return number % len(cluster.gateways)


FAULTS: Mapping[str, Fault] = {
    "kill -9 supervisor": lambda cluster, n, _rng: cluster.kill_worker(n),
    "kill -9 simulation": lambda cluster, n, rng: cluster.kill_simulation(n, rng),
    "kill -9 coordinator": lambda cluster, _n, rng: cluster.kill_coordinator(rng.uniform(0.0, 0.5)),
    "kill -9 coordinator while it packs": lambda cluster, _n, rng: cluster.kill_packing_coordinator(
        1.0, rng.uniform(0.0, 0.03)
    ),
    "SIGTERM supervisor": lambda cluster, n, _rng: cluster.terminate_worker(n),
    "SIGSTOP supervisor beyond the lease": lambda cluster, n, rng: cluster.freeze_worker(
        n, rng.uniform(1.1, 2.0) * LEASE_S
    ),
    "SIGSTOP supervisor for a moment": lambda cluster, n, rng: cluster.freeze_worker(n, rng.uniform(0.1, 1.0)),
    "SIGSTOP coordinator": lambda cluster, _n, rng: cluster.freeze_coordinator(rng.uniform(0.2, 1.5) * LEASE_S),
    "replies lost": lambda cluster, n, rng: cluster.wires.mute(n, rng.uniform(0.1, 1.5)),
    "host cut off and healed": lambda cluster, n, rng: cluster.wires.cut(n, rng.uniform(0.05, 1.5) * LEASE_S),
    "link reset": lambda cluster, n, _rng: cluster.wires.cut(n, 0.0),
    "kill -9 gateway": lambda cluster, n, rng: cluster.kill_gateway(_of(cluster, n), rng.uniform(0.0, 2.0)),
    "SIGSTOP gateway": lambda cluster, n, rng: cluster.freeze_gateway(_of(cluster, n), rng.uniform(0.2, 2.0) * LEASE_S),
    "full disk": _fill_disk,
    "slow disk": _slow_disk,
}
"""Name -> function that injects the fault into the n-th worker or gateway of a cluster, or into its coordinator. The
function returns `None` if the process is not in the required state."""
_GATEWAYS = frozenset({"kill -9 gateway", "SIGSTOP gateway"})


def possible(cluster: ChaosCluster) -> list[str]:
    """Returns the faults that this machine and this cluster support."""
    missing = {"full disk", "slow disk"} if cluster.disk is None else set(cluster.disk.missing)
    if not cluster.gateways:
        missing |= _GATEWAYS
    if cluster.gateways or cluster.commands.record is not Recording.STATES:
        missing.add("kill -9 coordinator while it packs")
    if not cluster.commands.has_small_disk:
        missing.add("full disk")
    if cluster.commands.crashes < LARGE_CRASH_BUDGET:
        missing.add("kill -9 simulation")
    return [name for name in FAULTS if name not in missing]
