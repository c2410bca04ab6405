"""`make chaos`: repeated runs with injected faults. Every dataset must equal that of a one-worker run without faults.

Ends after a time limit or a number of faults with an effect and prints a table. Exits with 1 when an episode was lost,
duplicated or damaged. The seed of a round determines its faults: `--seed S --round K` repeats the K-th round.
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
from schemas.terms import Recording
from tests.builders.tools import find_system_tools
from tests.chaos.cluster import LARGE_CRASH_BUDGET, ClusterCommands, fake_commands, real_commands
from tests.chaos.faults import FAULTS
from tests.chaos.peers import PEER_KINDS, Peers
from tests.chaos.round import FaultLoad, reference_digest, run_round
from tests.chaos.tally import Tally

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
[[scenes]]
name = "home"
layouts = 4
episodes = 8
"""
_IN_LAYOUTS = 8
"""Number of episodes in generated layouts in `_REAL_PLAN`. With them, a kill can also interrupt the building of a
layout."""
_PACKING_S = 0.3
"""Interval between checkpoints in rounds that pack episodes, seconds; a checkpoint packs episodes."""
log = Console(stderr=True, highlight=False)


def run_campaign(
    command_sets: Sequence[ClusterCommands],
    root: Path,
    load: FaultLoad,
    seed: int,
    minutes: float,
    faults: int,
    *,
    at_once: int = 1,
    only: int | None = None,
    kept: Path | None = None,
) -> Tally:
    """Runs rounds with each set of commands in turn until the time limit or the number of faults is reached.

    Args:
        command_sets: commands that start the processes; all have the same plan.
        root: working directory.
        load: faults to inject in each round.
        seed: seed of round 0; round K uses `seed` + K.
        minutes: time after which no round starts.
        faults: number of faults with an effect after which no round starts.
        at_once: number of concurrent rounds.
        only: number of the only round to run.
        kept: tally file to continue from; written after each round.
    """
    tally = Tally.load(kept) if kept is not None else Tally()
    plans = {(commands.crashes, commands.record): commands for commands in command_sets}
    reference = {
        key: reference_digest(commands, root / f"reference-{'-'.join(map(str, key))}")
        for key, commands in plans.items()
    }
    log.print(f"reference digest: {', '.join(reference.values())}")
    before, started = tally.seconds, time.monotonic()
    numbers = itertools.count(tally.rounds.total()) if only is None else iter((only,))
    stop, playing = threading.Event(), set[Future[Tally]]()
    with ThreadPoolExecutor(at_once) as pool:
        try:
            while True:
                is_on = time.monotonic() - started < 60 * minutes and tally.faults.total() < faults
                while is_on and len(playing) < at_once and (number := next(numbers, None)) is not None:
                    commands, place = command_sets[number % len(command_sets)], root / f"round-{number}"
                    wanted = reference[commands.crashes, commands.record]
                    playing.add(pool.submit(run_round, commands, place, load, seed + number, wanted, stop))
                if not playing:
                    return tally
                done, playing = wait(playing, return_when=FIRST_COMPLETED)
                for one in done:
                    tally.add(one.result())
                    tally.seconds = before + time.monotonic() - started
                    _report(tally, one.result(), kept)
        finally:
            stop.set()


def _report(tally: Tally, one: Tally, kept: Path | None) -> None:
    if kept is not None:
        tally.save(kept)
    log.print(
        f"{tally.rounds.total()} rounds: {tally.faults.total()} faults, {tally.episodes} episodes, "
        f"{tally.seconds:.0f} s; the last, {', '.join(one.rounds)}: {one.faults.total()} faults, "
        f"{one.without_effect.total()} without effect, {one.seconds:.0f} s",
        soft_wrap=True,
    )
    for text in one.violations:
        log.print(f"violation: {text}", style="red")


def main() -> int:
    """Parses the command line and runs a campaign."""
    find_system_tools()
    options = _parse_options()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # an exception, so all processes are ended
    with tempfile.TemporaryDirectory(prefix="minivla-chaos-", dir=options.root) as folder:
        root = Path(folder)
        try:
            tally = run_campaign(
                _command_sets(options, root),
                root,
                FaultLoad(options.workers, options.per_round, (options.pause / 8, options.pause), _peers(options)),
                options.seed,
                options.minutes or (30.0 if options.faults is None else 240.0),
                options.faults or sys.maxsize,
                at_once=options.at_once,
                only=options.round,
                kept=options.tally,
            )
        finally:
            _keep_evidence(root)
    if options.json:
        sys.stdout.write(json.dumps(tally.to_plain(), indent=2) + "\n")
    else:
        tally.print(Console(highlight=False), (*FAULTS, *(PEER_KINDS if _peers(options) is not None else ())))
    too_few = options.round is None and tally.faults.total() < (options.faults or 0)
    if too_few:
        log.print(f"{tally.faults.total()} of {options.faults} faults had an effect: increase --minutes")
    return 1 if tally.violations or too_few else 0


def _parse_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--minutes", type=float, help="Time after which no round starts, minutes (default 30, or 240 with --faults)."
    )
    parser.add_argument(
        "--faults", type=int, help="Required number of faults with an effect; exits with 1 when the time ends first."
    )
    parser.add_argument("--per-round", type=int, default=200, help="Maximum faults per round (default 200).")
    parser.add_argument("--episodes", type=int, default=60, help="Episodes per round (default 60).")
    parser.add_argument("--workers", type=int, default=3, help="Number of hosts (default 3).")
    parser.add_argument(
        "--gateways", type=int, default=2, help="Gateways in every second round; 0 disables them (default 2)."
    )
    parser.add_argument(
        "--peers",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="Adds a hostile peer and a faulty host to every round (default; not with --simulation real).",
    )
    parser.add_argument("--at-once", type=int, default=2, help="Concurrent rounds (default 2).")
    parser.add_argument(
        "--longest", type=float, help="Timeout of a round, seconds (default: a multiple of the expected time)."
    )
    parser.add_argument(
        "--pause", type=float, default=0.4, help="Longest pause between two faults, seconds (default 0.4)."
    )
    parser.add_argument("--seed", type=int, default=1, help="Seed of round 0; round K uses SEED + K (default 1).")
    parser.add_argument("--round", type=int, help="Runs only this round, for example one that failed.")
    parser.add_argument(
        "--simulation",
        choices=("fake", "real"),
        default="fake",
        help="fake: no physics, tests the protocol; real: the installed command line.",
    )
    parser.add_argument(
        "--record",
        choices=tuple(Recording),
        default=Recording.FRAMES,
        help="Content that the episodes of a fake simulation store (default frames); episodes of states are packed.",
    )
    parser.add_argument("--tally", type=Path, help="File that stores the tally; an existing one is continued.")
    parser.add_argument("--root", type=Path, help="Working directory (default: a temporary folder).")
    parser.add_argument("--json", action="store_true", help="Prints the tally as JSON.")
    return parser.parse_args()


def _command_sets(options: argparse.Namespace, root: Path) -> tuple[ClusterCommands, ...]:
    if options.simulation == "real":
        plan = root / "plan.toml"
        plan.write_text(_REAL_PLAN.format(episodes=options.episodes))
        command_sets = [real_commands(plan, options.episodes + _IN_LAYOUTS)]
    else:
        budgets = (LARGE_CRASH_BUDGET, Budget().crashes) if options.peers else (LARGE_CRASH_BUDGET,)
        choices = itertools.product(budgets, sorted({0, options.gateways}))
        record = Recording(options.record)
        checkpoint_s = _PACKING_S if record is Recording.STATES else 30.0
        command_sets = [
            fake_commands(options.episodes, 2.0, number, checkpoint_s, crashes, record) for crashes, number in choices
        ]
    return tuple(replace(commands, longest_s=options.longest or commands.longest_s) for commands in command_sets)


def _peers(options: argparse.Namespace) -> Peers | None:
    return Peers() if options.peers and options.simulation == "fake" else None


def _keep_evidence(root: Path) -> None:
    """Copies logs and ledgers of failed rounds to the working directory."""
    for path in root.glob("round-*/evidence*"):
        shutil.copy(path, Path.cwd() / f"chaos-{path.parent.name}-{path.name}")


if __name__ == "__main__":
    sys.exit(main())
