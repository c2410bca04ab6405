"""One round: a run full of mishaps, from the first process to the verdict; and the calm run it is held against."""

from __future__ import annotations

import random
import shutil
import threading
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from tests.chaos.cluster import STORM_CRASHES, ChaosCluster, ClusterCommands
from tests.chaos.disk import Disk
from tests.chaos.fault_span import FaultSpan
from tests.chaos.faults import FAULTS, possible
from tests.chaos.hostile_peer import HostilePeer
from tests.chaos.peers import Peers, effects_of_peers, give_history
from tests.chaos.tally import Tally
from tests.chaos.verdict import digest_of, gathering_of, violations_of

__all__ = ["Stopped", "Storm", "calm_digest", "play_round"]

_DISK_MB = 64
_CALM_START_S = 2.0
_SHORT_DISK_S = (0.3, 2.0)
"""How long a disk stays full or slow."""
_TICK_S = 0.05


class Stopped(Exception):
    """The campaign was told to stop; the round counts for nothing."""


@dataclass(frozen=True)
class Storm:
    """How much befalls a round."""

    workers: int
    """Hosts."""
    faults: int
    """At most that many; fewer when the run is finished before."""
    pause_s: tuple[float, float] = (0.1, 0.7)
    """From one mishap to the next, shortest and longest."""
    peers: Peers | None = None
    """A hostile peer and a faulty host beside the workers; `None` for none."""


def calm_digest(cast: ClusterCommands, root: Path) -> str:
    """Returns the digest of the dataset that one undisturbed worker makes."""
    root.mkdir()
    with ChaosCluster(root, cast, 1) as party:
        deadline = time.monotonic() + cast.longest_s
        while len(party.archived()) < cast.episodes:
            assert time.monotonic() < deadline, party.log.read_text()[-4000:]
            party.tend()
            time.sleep(_TICK_S)
        party.end()
        digest = digest_of(party)
    shutil.rmtree(root)
    return digest


def play_round(
    cast: ClusterCommands, root: Path, storm: Storm, seed: int, calm: str, stop: threading.Event | None = None
) -> Tally:
    """Plays one run and returns what befell it and what was wrong with it.

    Args:
        cast: how its parts are started.
        root: where to work; removed when all went well, else left with log and ledger as `evidence*`.
        storm: how much befalls it.
        seed: of the draws; when each of them falls is the machine's affair.
        calm: the digest its dataset must have.
        stop: ends the round early.

    Raises:
        Stopped: `stop` was set.
    """
    root.mkdir()
    with ExitStack() as stack:
        disk = stack.enter_context(Disk(root, _DISK_MB))
        rng = random.Random(seed)
        damage = rng.choice(storm.peers.damages) if storm.peers is not None else 0.0
        party = stack.enter_context(ChaosCluster(root, cast, storm.workers, disk, damage))
        hostile = _hostile_peer(party, storm, random.Random(f"{seed} hostile"), stack)
        tally = Tally(missing=disk.missing, rounds=Counter({_topology(cast, storm): 1}))
        begun = time.monotonic()
        spells = _harass(party, disk, storm, rng, stop or threading.Event())
        if len(party.archived()) < cast.episodes:
            party.violations.append(f"{len(party.archived())} of {cast.episodes} episodes after {cast.longest_s:g} s")
            shutil.copy(party.out / "ledger.db", root / "evidence-then.db")
        if hostile is not None:
            hostile.stop()
        party.end()
        tally.seconds = time.monotonic() - begun
        if hostile is not None:
            hostile.settle()
            party.violations += hostile.violations
            spells += hostile.acts + effects_of_peers(party)
        party.violations += gathering_of(party)
        party.violations += violations_of(party)
        digest = digest_of(party)
        if digest != calm:
            party.violations.append(f"digest {digest}, calm {calm}")
        for kind, spell in spells:
            (tally.faults if spell.felt else tally.unfelt)[kind] += 1
        tally.episodes = len(party.archived())
        tally.outcomes = party.outcomes()
        tally.restarts = party.restarts
        tally.violations = [f"seed {seed}: {text}" for text in party.violations]
        if party.violations:
            shutil.copy(party.out / "ledger.db", root / "evidence.db")
            shutil.copy(party.log, root / "evidence.log")
    if not tally.violations:
        shutil.rmtree(root)
    return tally


def _harass(
    party: ChaosCluster, disk: Disk, storm: Storm, rng: random.Random, stop: threading.Event
) -> list[tuple[str, FaultSpan]]:
    """Lets mishaps fall until every episode is archived or time is up; then calms everything down."""
    kinds, spells = possible(party), list[tuple[str, FaultSpan]]()
    deadline = time.monotonic() + party.cast.longest_s
    has_history = storm.peers is None
    next_harm, relief = time.monotonic() + _CALM_START_S, float("inf")
    while len(party.archived()) < party.cast.episodes and time.monotonic() < deadline:
        now = time.monotonic()
        if now > relief:
            disk.clear()
            relief = float("inf")
        if len(spells) < storm.faults and now > next_harm:
            kind = rng.choice(kinds)
            spell = FAULTS[kind](party, rng.randrange(storm.workers), rng)
            if spell is not None:
                spells.append((kind, spell))
                relief = min(relief, now + rng.uniform(*_SHORT_DISK_S)) if kind.endswith("disk") else relief
                next_harm = time.monotonic() + rng.uniform(*storm.pause_s)
        has_history = has_history or give_history(party, rng)
        party.tend()
        if stop.wait(_TICK_S):
            raise Stopped
    disk.clear()
    party.tend(everybody=True)
    return spells


def _hostile_peer(party: ChaosCluster, storm: Storm, rng: random.Random, stack: ExitStack) -> HostilePeer | None:
    if storm.peers is None:
        return None
    return stack.enter_context(HostilePeer(party, rng, storm.peers.pause_s))


def _topology(cast: ClusterCommands, storm: Storm) -> str:
    where = f"with {cast.gateways} gateways" if cast.gateways else "without gateways"
    budget = f" and a budget of {cast.crashes} crashes" if cast.crashes < STORM_CRASHES else ""
    return where + (" with peers" if storm.peers is not None else "") + budget
