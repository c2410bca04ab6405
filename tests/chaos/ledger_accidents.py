"""`make ledger-accidents`: loses or damages the ledger of runs at random moments and then repeats their command.

No episode on disk may be simulated again or moved to quarantine; every dataset must equal that of an undisturbed run.
Exits with 1 otherwise. The seed of a run determines the moments and the damage. With `--tally`, a stopped campaign can
be continued.
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
from tests.chaos.round import Stopped, reference_digest
from tests.chaos.tally import Tally
from tests.chaos.verdict import digest_of, violations_of

_TICK_S = 0.05
_LONGEST_S = 1.0
"""Longest duration of a simulation, seconds."""
log = Console(stderr=True, highlight=False)


def run_accidents(
    commands: ClusterCommands,
    root: Path,
    kinds: Sequence[str],
    seed: int,
    reference: str,
    stop: threading.Event | None = None,
) -> Tally:
    """Runs one round and damages its ledger several times.

    Args:
        commands: commands that start the processes.
        root: working directory; removed if there are no violations.
        kinds: kinds of damage, in order.
        seed: seed of the moments and of the damage.
        reference: expected digest of the dataset.
        stop: ends the run early.

    Raises:
        Stopped: `stop` was set.
    """
    root.mkdir()
    rng, tally, started = random.Random(seed), Tally(rounds=Counter({"with accidents": 1})), time.monotonic()
    stop = stop or threading.Event()
    with ChaosCluster(root, commands, 2) as cluster:
        notes: list[str] = []
        share = commands.episodes / len(kinds)
        for number, kind in enumerate(kinds):
            moment = max(1, min(commands.episodes - 1, round((number + rng.random()) * share)))
            _wait(cluster, 1 if number == 0 else 0, stop)
            copies = [*root.glob("copy-*"), copy_ledger(cluster.out, root / f"copy-{number}")]
            _wait(cluster, moment, stop)
            stop.wait(rng.uniform(0.0, 0.5))
            while cluster.kill_coordinator(float("inf")) is None:
                _tend(cluster, stop)
            kept = {int(path.stem[3:]) for path in (cluster.out / "episodes").glob("ep_*.zip")}
            notes.append(f"{len(kept)} episodes on disk: {ACCIDENTS[kind](cluster.out, copies, rng)}")
            since = time.time()
            cluster.tend(at_once=True)
            tally.faults[kind] += 1
            _wait(cluster, len(kept), stop)
            cluster.violations += _repeated_episodes(cluster, kept, since)
        _wait(cluster, commands.episodes, stop)
        cluster.end()
        cluster.violations += _repeated_episodes(cluster, kept, since)
        cluster.violations += violations_of(cluster)
        cluster.violations += [
            f"{path.name} is in quarantine" for path in (cluster.out / "quarantine").glob("ep_*.zip.????????")
        ]
        if digest_of(cluster) != reference:
            cluster.violations.append(f"digest {digest_of(cluster)}, reference {reference}")
        tally.episodes = len(cluster.archived())
        tally.outcomes = cluster.outcomes()
        tally.restarts = cluster.restarts
        tally.violations = [f"seed {seed} ({'; '.join(notes)}): {text}" for text in dict.fromkeys(cluster.violations)]
        if cluster.violations:
            shutil.copy(cluster.out / "ledger.db", root / "evidence.db")
            shutil.copy(cluster.log, root / "evidence.log")
    tally.seconds = time.monotonic() - started
    if not tally.violations:
        shutil.rmtree(root)
    return tally


def _wait(cluster: ChaosCluster, archived: int, stop: threading.Event) -> None:
    """Waits until at least `archived` episodes are archived; a timeout is a violation."""
    deadline = time.monotonic() + cluster.commands.longest_s
    while len(cluster.archived()) < archived:
        if time.monotonic() > deadline:
            cluster.violations.append(
                f"{len(cluster.archived())} of {archived} episodes after {cluster.commands.longest_s:g} s"
            )
            return
        _tend(cluster, stop)


def _tend(cluster: ChaosCluster, stop: threading.Event) -> None:
    cluster.tend()
    if stop.wait(_TICK_S):
        raise Stopped


def _repeated_episodes(cluster: ChaosCluster, kept: set[int], since: float) -> list[str]:
    """Returns a violation if workers have claimed jobs of episodes that were on disk."""
    claims = cluster.query(
        "select jobs.idx from events join jobs on jobs.id = events.job_id "
        f"where events.event = 'claimed' and events.sid != 'repair' and events.at > {since}"
    )
    again = sorted({index for (index,) in claims} & kept)
    return [f"episodes {again} were on disk and are simulated again"] if again else []


def run_campaign(
    commands: ClusterCommands, root: Path, moments: int, per_run: int, seed: int, at_once: int, kept: Path | None
) -> Tally:
    """Runs rounds until the ledger was damaged `moments` times.

    Args:
        commands: commands that start the processes.
        root: working directory.
        moments: total number of damaged ledgers, including the number in the stored tally.
        per_run: how often the ledger is damaged in each run.
        seed: seed of run 0; run K uses `seed` + K.
        at_once: number of concurrent runs.
        kept: tally file to continue from; written after each run.
    """
    tally = Tally.load(kept) if kept is not None else Tally()
    reference = reference_digest(commands, root / "reference")
    stop, before, started = threading.Event(), tally.seconds, time.monotonic()
    done, wanted = tally.rounds.total(), -(-max(0, moments - tally.faults.total()) // per_run)

    def play(number: int) -> Tally:
        kinds = list(itertools.islice(itertools.cycle(ACCIDENTS), number * per_run, (number + 1) * per_run))
        return run_accidents(commands, root / f"run-{number}", kinds, seed + number, reference, stop)

    with ThreadPoolExecutor(at_once) as pool:
        try:
            for one in pool.map(play, range(done, done + wanted)):
                tally.add(one)
                tally.seconds = before + time.monotonic() - started
                if kept is not None:
                    tally.save(kept)
                log.print(f"{tally.rounds.total()} runs: {tally.faults.total()} accidents, {tally.episodes} episodes")
                for text in one.violations:
                    log.print(f"violation: {text}", style="red", soft_wrap=True)
        finally:
            stop.set()
    return tally


def main() -> int:
    """Parses the command line and runs a campaign."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--moments", type=int, default=50, help="Total number of damaged ledgers (default 50).")
    parser.add_argument("--per-run", type=int, default=5, help="Damaged ledgers per run (default 5).")
    parser.add_argument("--episodes", type=int, default=24, help="Episodes per run (default 24).")
    parser.add_argument("--at-once", type=int, default=2, help="Concurrent runs (default 2).")
    parser.add_argument("--seed", type=int, default=1, help="Seed of run 0; run K uses SEED + K (default 1).")
    parser.add_argument("--tally", type=Path, help="File that stores the tally; an existing one is continued.")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # an exception, so all processes are ended
    with tempfile.TemporaryDirectory(prefix="minivla-ledger-") as folder:
        root = Path(folder)
        commands = fake_commands(options.episodes, _LONGEST_S, checkpoint_s=1.0)
        try:
            tally = run_campaign(
                commands, root, options.moments, options.per_run, options.seed, options.at_once, options.tally
            )
        finally:
            for path in root.glob("run-*/evidence*"):
                shutil.copy(path, Path.cwd() / f"ledger-{path.parent.name}-{path.name}")
    tally.print(Console(highlight=False), ACCIDENTS)
    return 1 if tally.violations or tally.faults.total() < options.moments else 0


if __name__ == "__main__":
    sys.exit(main())
