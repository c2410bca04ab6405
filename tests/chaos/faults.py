"""The mishaps of a campaign: one line each, so that a new one is a line here.

Each hits somebody in the middle of the work or is not to be had at that moment; what is felt later, its spell says.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping

from tests.chaos.cluster import LEASE_S, STORM_CRASHES, ChaosCluster
from tests.chaos.fault_span import FaultSpan

__all__ = ["FAULTS", "possible"]

Fault = Callable[[ChaosCluster, int, random.Random], FaultSpan | None]


def _fill_disk(party: ChaosCluster, _number: int, _rng: random.Random) -> FaultSpan | None:
    if party.disk is None:
        return None
    party.note_full_disk()
    return party.disk.fill()


def _slow_disk(party: ChaosCluster, _number: int, rng: random.Random) -> FaultSpan | None:
    return party.disk.slow(rng.randint(20, 300)) if party.disk is not None else None


def _of(party: ChaosCluster, number: int) -> int:
    return number % len(party.gateways)


FAULTS: Mapping[str, Fault] = {
    "kill -9 supervisor": lambda party, n, _rng: party.kill_worker(n),
    "kill -9 simulation": lambda party, n, rng: party.kill_simulation(n, rng),
    "kill -9 coordinator": lambda party, _n, rng: party.kill_coordinator(rng.uniform(0.0, 0.5)),
    "SIGTERM supervisor": lambda party, n, _rng: party.dismiss_worker(n),
    "SIGSTOP supervisor beyond the lease": lambda party, n, rng: party.freeze_worker(
        n, rng.uniform(1.1, 2.0) * LEASE_S
    ),
    "SIGSTOP supervisor for a moment": lambda party, n, rng: party.freeze_worker(n, rng.uniform(0.1, 1.0)),
    "SIGSTOP coordinator": lambda party, _n, rng: party.freeze_coordinator(rng.uniform(0.2, 1.5) * LEASE_S),
    "replies lost": lambda party, n, rng: party.wires.mute(n, rng.uniform(0.1, 1.5)),
    "host cut off and healed": lambda party, n, rng: party.wires.cut(n, rng.uniform(0.05, 1.5) * LEASE_S),
    "link reset": lambda party, n, _rng: party.wires.cut(n, 0.0),
    "kill -9 gateway": lambda party, n, rng: party.kill_gateway(_of(party, n), rng.uniform(0.0, 2.0)),
    "SIGSTOP gateway": lambda party, n, rng: party.freeze_gateway(_of(party, n), rng.uniform(0.2, 2.0) * LEASE_S),
    "full disk": _fill_disk,
    "slow disk": _slow_disk,
}
"""Name -> what to do to a party's n-th worker, to the gateway of that number, or to its coordinator; `None` says that
nobody is there to be hit."""
_GATEWAYS = frozenset({"kill -9 gateway", "SIGSTOP gateway"})


def possible(party: ChaosCluster) -> list[str]:
    """Returns the faults that can be had on this machine with this party."""
    missing = {"full disk", "slow disk"} if party.disk is None else set(party.disk.missing)
    if not party.gateways:
        missing |= _GATEWAYS
    if not party.cast.has_small_disk:
        missing.add("full disk")
    if party.cast.crashes < STORM_CRASHES:
        missing.add("kill -9 simulation")
    return [name for name in FAULTS if name not in missing]
