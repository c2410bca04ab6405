"""`make ledger-accidents`: runs whose ledger is lost or damaged at random moments; then the same command is run again.

No episode that was on disk may be simulated again or end in quarantine; every dataset must equal that of a calm run.
Ends with 1 otherwise. A run is its seed; the tally is kept, so that a campaign goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import itertools
import random
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from rich.console import Console

from tests.chaos.accidents import ACCIDENTS, copy_ledger
from tests.chaos.cluster import ChaosCluster, ClusterCommands, fake_commands
from tests.chaos.round import Stopped, calm_digest
from tests.chaos.tally import Tally
from tests.chaos.verdict import digest_of, violations_of

__all__ = ["main", "play_accidents"]

_TICK_S = 0.05
_LONGEST_S = 1.0
"""Of a simulation."""
log = Console(stderr=True, highlight=False)


def play_accidents(
    cast: ClusterCommands, root: Path, kinds: Sequence[str], seed: int, calm: str, stop: threading.Event | None = None
) -> Tally:
    """Plays one run and lets accidents befall its ledger, one after the other.

    Args:
        cast: how its parts are started.
        root: where to work; removed when all went well.
        kinds: of accidents, in order.
        seed: of the moments and of what each accident does.
        calm: the digest its dataset must have.
        stop: ends the run early.

    Raises:
        Stopped: `stop` was set.
    """
    root.mkdir()
    rng, tally, begun = random.Random(seed), Tally(rounds=Counter({"with accidents": 1})), time.monotonic()
    stop = stop or threading.Event()
    with ChaosCluster(root, cast, 2) as party:
        notes: list[str] = []
        share = cast.episodes / len(kinds)
        for number, kind in enumerate(kinds):
            moment = max(1, min(cast.episodes - 1, round((number + rng.random()) * share)))
            _wait(party, 1 if number == 0 else 0, stop)
            copies = [*root.glob("copy-*"), copy_ledger(party.out, root / f"copy-{number}")]
            _wait(party, moment, stop)
            stop.wait(rng.uniform(0.0, 0.5))
            while party.kill_coordinator(float("inf")) is None:
                _tend(party, stop)
            kept = {int(path.stem[3:]) for path in (party.out / "episodes").glob("ep_*.zip")}
            notes.append(f"{len(kept)} episodes on disk: {ACCIDENTS[kind](party.out, copies, rng)}")
            since = time.time()
            party.tend(everybody=True)
            tally.faults[kind] += 1
            _wait(party, len(kept), stop)
            party.violations += _made_again(party, kept, since)
        _wait(party, cast.episodes, stop)
        party.end()
        party.violations += _made_again(party, kept, since)
        party.violations += violations_of(party)
        party.violations += [
            f"{path.name} is in quarantine" for path in (party.out / "quarantine").glob("ep_*.zip.????????")
        ]
        if digest_of(party) != calm:
            party.violations.append(f"digest {digest_of(party)}, calm {calm}")
        tally.episodes = len(party.archived())
        tally.outcomes = party.outcomes()
        tally.restarts = party.restarts
        tally.violations = [f"seed {seed} ({'; '.join(notes)}): {text}" for text in dict.fromkeys(party.violations)]
        if party.violations:
            shutil.copy(party.out / "ledger.db", root / "evidence.db")
            shutil.copy(party.log, root / "evidence.log")
    tally.seconds = time.monotonic() - begun
    if not tally.violations:
        shutil.rmtree(root)
    return tally


def _wait(party: ChaosCluster, archived: int, stop: threading.Event) -> None:
    """Waits until so many episodes are archived."""
    deadline = time.monotonic() + party.cast.longest_s
    while len(party.archived()) < archived:
        if time.monotonic() > deadline:
            party.violations.append(f"{len(party.archived())} of {archived} episodes after {party.cast.longest_s:g} s")
            return
        _tend(party, stop)


def _tend(party: ChaosCluster, stop: threading.Event) -> None:
    party.tend()
    if stop.wait(_TICK_S):
        raise Stopped


def _made_again(party: ChaosCluster, kept: set[int], since: float) -> list[str]:
    """Returns which episodes were given to a worker although they were on disk."""
    claims = party.query(
        "select jobs.idx from events join jobs on jobs.id = events.job_id "
        f"where events.event = 'claimed' and events.sid != 'repair' and events.at > {since}"
    )
    again = sorted({index for (index,) in claims} & kept)
    return [f"episodes {again} were on disk and are simulated again"] if again else []


def run_campaign(
    cast: ClusterCommands, root: Path, moments: int, per_run: int, seed: int, at_once: int, kept: Path | None
) -> Tally:
    """Plays runs until so many accidents have happened.

    Args:
        cast: how the parts are started.
        root: where to work.
        moments: accidents wanted in all, those of the kept tally included.
        per_run: accidents of a run.
        seed: of run 0; the next ones count on.
        at_once: runs side by side.
        kept: file of a tally to go on from, written after each run.
    """
    tally = Tally.load(kept) if kept is not None else Tally()
    calm = calm_digest(cast, root / "calm")
    stop, before, begun = threading.Event(), tally.seconds, time.monotonic()
    done, wanted = tally.rounds.total(), -(-max(0, moments - tally.faults.total()) // per_run)

    def play(number: int) -> Tally:
        kinds = list(itertools.islice(itertools.cycle(ACCIDENTS), number * per_run, (number + 1) * per_run))
        return play_accidents(cast, root / f"run-{number}", kinds, seed + number, calm, stop)

    with ThreadPoolExecutor(at_once) as pool:
        try:
            for one in pool.map(play, range(done, done + wanted)):
                tally.add(one)
                tally.seconds = before + time.monotonic() - begun
                if kept is not None:
                    tally.save(kept)
                log.print(f"{tally.rounds.total()} runs: {tally.faults.total()} accidents, {tally.episodes} episodes")
                for text in one.violations:
                    log.print(f"violation: {text}", style="red", soft_wrap=True)
        finally:
            stop.set()
    return tally


def main() -> int:
    """Runs a campaign as told on the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--moments", type=int, default=50, help="accidents in all (default 50)")
    parser.add_argument("--per-run", type=int, default=5, help="accidents of one run (default 5)")
    parser.add_argument("--episodes", type=int, default=24, help="episodes of one run (default 24)")
    parser.add_argument("--at-once", type=int, default=2, help="runs side by side (default 2)")
    parser.add_argument("--seed", type=int, default=1, help="of run 0; the next ones count on (default 1)")
    parser.add_argument("--tally", type=Path, help="file to keep the count in and to go on from")
    told = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that nobody is left behind
    with tempfile.TemporaryDirectory(prefix="minivla-ledger-") as folder:
        root = Path(folder)
        cast = fake_commands(told.episodes, _LONGEST_S, checkpoint_s=1.0)
        try:
            tally = run_campaign(cast, root, told.moments, told.per_run, told.seed, told.at_once, told.tally)
        finally:
            for path in root.glob("run-*/evidence*"):
                shutil.copy(path, Path.cwd() / f"ledger-{path.parent.name}-{path.name}")
    tally.print(Console(highlight=False), ACCIDENTS)
    return 1 if tally.violations or tally.faults.total() < told.moments else 0


if __name__ == "__main__":
    sys.exit(main())
