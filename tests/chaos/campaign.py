"""`make chaos`: round after round of a run full of mishaps; every dataset must equal that of a calm one-worker run.

Ends after a time or a count of faults that were felt, prints its table, and ends with 1 when anything was lost, doubled
or torn. A round is its seed: `--seed S --round K` plays the K-th round of a campaign again.
"""

from __future__ import annotations

import argparse
import itertools
import json
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from schemas.plan import Budget
from tests.builders.tools import find_system_tools
from tests.chaos.cluster import STORM_CRASHES, ClusterCommands, fake_commands, real_commands
from tests.chaos.faults import FAULTS
from tests.chaos.peers import PEER_KINDS, Peers
from tests.chaos.round import Storm, calm_digest, play_round
from tests.chaos.tally import Tally

__all__ = ["main", "run_campaign"]

_REAL_PLAN = """
name = "chaos"
expert = "proportional"
[tiers]
near = 1.0
[splits]
train_id = 1.0
[[scenes]]
name = "hospital"
episodes = {episodes}
"""
log = Console(stderr=True, highlight=False)


def run_campaign(
    casts: Sequence[ClusterCommands],
    root: Path,
    storm: Storm,
    seed: int,
    minutes: float,
    faults: int,
    *,
    at_once: int = 1,
    only: int | None = None,
    kept: Path | None = None,
) -> Tally:
    """Plays rounds, with each cast in turn, until time or faults are used up.

    Args:
        casts: how the parts are started; each has the same plan.
        root: where to work.
        storm: how much befalls a round.
        seed: of round 0; the next ones count on.
        minutes: begin no round after that long.
        faults: begin no round once so many were felt.
        at_once: rounds that run side by side.
        only: play this round and no other.
        kept: file of a tally to go on from, written after each round.
    """
    tally = Tally.load(kept) if kept is not None else Tally()
    plans = {cast.crashes: cast for cast in casts}
    calm = {crashes: calm_digest(cast, root / f"calm-{crashes}") for crashes, cast in plans.items()}
    log.print(f"calm digest {', '.join(calm.values())}")
    before, begun = tally.seconds, time.monotonic()
    numbers = itertools.count(tally.rounds.total()) if only is None else iter((only,))
    stop, playing = threading.Event(), set[Future[Tally]]()
    with ThreadPoolExecutor(at_once) as pool:
        try:
            while True:
                is_on = time.monotonic() - begun < 60 * minutes and tally.faults.total() < faults
                while is_on and len(playing) < at_once and (number := next(numbers, None)) is not None:
                    cast, place = casts[number % len(casts)], root / f"round-{number}"
                    playing.add(pool.submit(play_round, cast, place, storm, seed + number, calm[cast.crashes], stop))
                if not playing:
                    return tally
                done, playing = wait(playing, return_when=FIRST_COMPLETED)
                for one in done:
                    tally.add(one.result())
                    tally.seconds = before + time.monotonic() - begun
                    _tell(tally, one.result(), kept)
        finally:
            stop.set()


def _tell(tally: Tally, one: Tally, kept: Path | None) -> None:
    if kept is not None:
        tally.save(kept)
    log.print(
        f"{tally.rounds.total()} rounds: {tally.faults.total()} faults, {tally.episodes} episodes, "
        f"{tally.seconds:.0f} s; the last, {', '.join(one.rounds)}: {one.faults.total()} faults, "
        f"{one.unfelt.total()} without effect, {one.seconds:.0f} s",
        soft_wrap=True,
    )
    for text in one.violations:
        log.print(f"violation: {text}", style="red")


def main() -> int:
    """Runs a campaign as told on the command line."""
    find_system_tools()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, help="begin no round after that long (default 30; with --faults 240)")
    parser.add_argument("--faults", type=int, help="go on until so many were felt; fewer in that time end with 1")
    parser.add_argument("--per-round", type=int, default=200, help="faults of one round (default 200)")
    parser.add_argument("--episodes", type=int, default=60, help="episodes of one round (default 60)")
    parser.add_argument("--workers", type=int, default=3, help="hosts (default 3)")
    parser.add_argument("--gateways", type=int, default=2, help="of every second round, 0 for none (default 2)")
    parser.add_argument(
        "--peers",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="a hostile peer and a faulty host in every round (default; not with --simulation real)",
    )
    parser.add_argument("--at-once", type=int, default=2, help="rounds side by side (default 2)")
    parser.add_argument("--longest", type=float, help="what a round may take, s (default: a few times what it needs)")
    parser.add_argument("--pause", type=float, default=0.4, help="longest pause between two faults, s (default 0.4)")
    parser.add_argument("--seed", type=int, default=1, help="of round 0; the next ones count on (default 1)")
    parser.add_argument("--round", type=int, help="play this round and no other, e.g. one that failed")
    parser.add_argument(
        "--simulation",
        choices=("fake", "real"),
        default="fake",
        help="fake: no physics, the protocol is on trial; real: the installed command line",
    )
    parser.add_argument("--tally", type=Path, help="file to keep the count in and to go on from")
    parser.add_argument("--root", type=Path, help="where to work; default: a temporary folder")
    parser.add_argument("--json", action="store_true", help="print the tally as JSON")
    told = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that nobody is left behind
    with tempfile.TemporaryDirectory(prefix="minivla-chaos-", dir=told.root) as folder:
        root = Path(folder)
        try:
            tally = run_campaign(
                _casts(told, root),
                root,
                Storm(told.workers, told.per_round, (told.pause / 8, told.pause), _peers(told)),
                told.seed,
                told.minutes or (30.0 if told.faults is None else 240.0),
                told.faults or sys.maxsize,
                at_once=told.at_once,
                only=told.round,
                kept=told.tally,
            )
        finally:
            _keep_evidence(root)
    if told.json:
        sys.stdout.write(json.dumps(tally.to_plain(), indent=2) + "\n")
    else:
        tally.print(Console(highlight=False), (*FAULTS, *(PEER_KINDS if _peers(told) is not None else ())))
    too_few = told.round is None and tally.faults.total() < (told.faults or 0)
    if too_few:
        log.print(f"asked for {told.faults} faults, {tally.faults.total()} were felt: give it more --minutes")
    return 1 if tally.violations or too_few else 0


def _casts(told: argparse.Namespace, root: Path) -> tuple[ClusterCommands, ...]:
    if told.simulation == "real":
        plan = root / "plan.toml"
        plan.write_text(_REAL_PLAN.format(episodes=told.episodes))
        casts = [real_commands(plan, told.episodes)]
    else:
        budgets = (STORM_CRASHES, Budget().crashes) if told.peers else (STORM_CRASHES,)
        choices = itertools.product(budgets, sorted({0, told.gateways}))
        casts = [fake_commands(told.episodes, 2.0, number, crashes=crashes) for crashes, number in choices]
    return tuple(replace(cast, longest_s=told.longest or cast.longest_s) for cast in casts)


def _peers(told: argparse.Namespace) -> Peers | None:
    return Peers() if told.peers and told.simulation == "fake" else None


def _keep_evidence(root: Path) -> None:
    """Copies log and ledgers of rounds in which something was wrong to the working directory."""
    for path in root.glob("round-*/evidence*"):
        shutil.copy(path, Path.cwd() / f"chaos-{path.parent.name}-{path.name}")


if __name__ == "__main__":
    sys.exit(main())
