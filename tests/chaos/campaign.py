"""`make chaos`: round after round of a run full of mishaps; every dataset must equal that of a calm one-worker run.

Bounded by minutes and by a count of faults; prints its table and ends with 1 when anything was lost, doubled or torn.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from coordinator.check.validator import Validator
from coordinator.gateway.gather import gather
from coordinator.repair.mend import Patient, repair
from schemas.digest import dataset_digest
from tests.builders.ledger import room_catalog, room_plan
from tests.chaos.disk import Disk
from tests.chaos.faults import FAULTS, possible
from tests.chaos.party import Cast, Party, fake_cast, real_cast

__all__ = ["Tally", "calm_digest", "digest_of", "play_round", "run_campaign", "violations_of"]

DISK_MB = 64
_HARMLESS_S = 2.0
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


@dataclass
class Tally:
    """What a campaign has seen."""

    faults: Counter[str] = field(default_factory=Counter)
    missing: dict[str, str] = field(default_factory=dict)
    """Fault -> why it could not be had."""
    rounds: int = 0
    episodes: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    restarts: Counter[str] = field(default_factory=Counter)
    violations: list[str] = field(default_factory=list)
    seconds: float = 0.0


def calm_digest(cast: Cast, root: Path) -> str:
    """Returns the digest of the dataset that one undisturbed worker makes."""
    root.mkdir()
    with Party(root, cast, 1) as party:
        _await_all(party, time.monotonic() + cast.longest_s)
        party.end()
        digest = digest_of(party)
    shutil.rmtree(root)
    return digest


def play_round(
    cast: Cast, root: Path, workers: int, seed: int, most: int, tally: Tally, pause: tuple[float, float] = (0.1, 0.7)
) -> str:
    """Plays one run with up to `most` mishaps, adds what came of it to the tally, and returns its dataset's digest."""
    root.mkdir()
    rng = random.Random(seed)
    with ExitStack() as stack:
        disk = stack.enter_context(Disk(root, DISK_MB))
        party = stack.enter_context(Party(root, cast, workers, disk))
        kinds = possible(party)
        tally.missing |= disk.missing
        deadline, done = time.monotonic() + cast.longest_s, 0
        next_harm, relief = time.monotonic() + 2.0, float("inf")
        while len(party.archived()) < cast.episodes and time.monotonic() < deadline:
            now = time.monotonic()
            if now > relief:
                disk.clear()
                relief = float("inf")
            if done < most and now > next_harm:
                kind = rng.choice(kinds)
                FAULTS[kind](party, rng.randrange(workers), rng)
                tally.faults[kind] += 1
                done += 1
                relief = min(relief, now + rng.uniform(0.3, _HARMLESS_S)) if kind.endswith("disk") else relief
                next_harm = time.monotonic() + rng.uniform(*pause)
            party.tend()
            time.sleep(0.05)
        disk.clear()
        party.tend(everybody=True)
        if len(party.archived()) < cast.episodes:
            party.violations.append(f"{len(party.archived())} of {cast.episodes} episodes after {cast.longest_s:g} s")
            shutil.copy(party.log, root.with_suffix(".log"))
        party.end()
        party.violations += gathering_of(party)
        party.violations += violations_of(party)
        digest = digest_of(party)
        tally.rounds += 1
        tally.episodes += len(party.archived())
        tally.outcomes += party.outcomes()
        tally.restarts += party.restarts
        tally.violations += [f"seed {seed}: {text}" for text in party.violations]
        if party.violations:
            shutil.copy(party.log, root.with_suffix(".log"))
    shutil.rmtree(root, ignore_errors=True)
    return digest


def run_campaign(
    casts: Sequence[Cast], root: Path, workers: int, seed: int, minutes: float, most_faults: int, per_round: int
) -> Tally:
    """Plays rounds, with each cast in turn, until time or faults are used up."""
    tally = Tally()
    calm = calm_digest(casts[0], root / "calm")
    log.print(f"calm digest {calm}")
    begun = time.monotonic()
    number = 0
    while time.monotonic() - begun < 60 * minutes and tally.faults.total() < most_faults:
        most = min(per_round, most_faults - tally.faults.total())
        digest = play_round(casts[number % len(casts)], root / f"round-{number}", workers, seed + number, most, tally)
        if digest != calm:
            tally.violations.append(f"seed {seed + number}: digest {digest}, calm {calm}")
        number += 1
        done, seconds = tally.faults.total(), time.monotonic() - begun
        log.print(f"round {number}: {done} faults, {tally.episodes} episodes, {seconds:.0f} s")
        for text in tally.violations:
            log.print(f"violation: {text}", style="red")
    tally.seconds = time.monotonic() - begun
    return tally


def _await_all(party: Party, deadline: float) -> None:
    while len(party.archived()) < party.cast.episodes:
        assert time.monotonic() < deadline, party.log.read_text()[-4000:]
        party.tend()
        time.sleep(0.05)


def digest_of(party: Party) -> str:
    return dataset_digest((str(index), digest) for index, digest in party.archived().items())


def gathering_of(party: Party) -> Iterator[str]:
    """Brings together what gateways keep, so that the dataset is whole; yields what cannot be had."""
    if not party.gateways:
        return
    report = gather(_patient(party), party.stores, datetime.now(UTC))
    yield from (f"{one.episode} is not whole at {one.gateway}: {one.why}" for one in report.missing)
    for store in party.stores:
        parts = list((store / ".staging").iterdir())
        if parts:
            yield f"part files are left in {store.name}"


def violations_of(party: Party) -> Iterator[str]:
    """Looks for what was lost, doubled or torn, once everybody has left."""
    wanted = set(range(1, party.cast.episodes + 1))
    files = {path.name: path for path in (party.out / "episodes").iterdir()}
    if set(files) != {f"ep_{index:06d}.zip" for index in wanted}:
        yield f"files {sorted(files)[:5]}... of {len(files)}, wanted {len(wanted)}"
    for index, sha256 in party.query("select idx, sha256 from episodes"):
        path = files.get(f"ep_{index:06d}.zip")
        if path is not None and hashlib.sha256(path.read_bytes()).hexdigest() != sha256:
            yield f"episode {index} is torn"
    if party.outcomes()["success"] != len(wanted):
        yield f"{party.outcomes()['success']} successes recorded for {len(wanted)} episodes"
    gained = Counter(dict(party.query("select job_id, count(*) from events where state = 'archived' group by job_id")))
    lost = Counter(dict(party.query("select job_id, count(*) from events where event = 'lost' group by job_id")))
    doubled = [job for job in gained if gained[job] - lost[job] != 1]
    if doubled:
        yield f"jobs {doubled[:5]} archived more than once"
    if list((party.out / ".staging").iterdir()):
        yield "part files are left"
    for held in party.query("select idx, state from jobs where state in ('leased', 'submitted')"):
        yield f"episode {held[0]} is still {held[1]}"
    yield from _disagreements(party)


def _disagreements(party: Party) -> Iterator[str]:
    """What `factory repair` would find between files, ledger and tables; only for the run whose scene is synthetic."""
    if not party.cast.has_small_disk:
        return
    with Validator() as validator:
        report = repair(_patient(party), validator, datetime.now(UTC), apply=False)
    yield from (f"{action.kind} {action.what}: {action.why}" for action in report.actions)


def _patient(party: Party) -> Patient:
    plan, catalog = room_plan(party.cast.episodes, crashes=20), room_catalog(party.place)
    return Patient(party.out, party.out, f"sqlite:///{party.out / 'ledger.db'}", plan, catalog, {})


def _print(tally: Tally) -> None:
    out = Console(highlight=False)
    table = Table("fault", "injected", box=None, header_style="bold")
    table.columns[1].justify = "right"
    for kind in FAULTS:
        table.add_row(
            kind, str(tally.faults[kind]) if kind not in tally.missing else f"not here: {tally.missing[kind]}"
        )
    table.add_row("all", str(tally.faults.total()), style="bold")
    out.print(table)
    attempts = ", ".join(f"{count} {outcome}" for outcome, count in tally.outcomes.most_common())
    out.print(f"{tally.rounds} rounds, {tally.episodes} episodes in {tally.seconds:.0f} s; attempts: {attempts}")
    restarts = ", ".join(f"{count} {who}" for who, count in tally.restarts.items()) or "none"
    out.print(f"left by themselves and started again: {restarts}")
    out.print(f"violations = {len(tally.violations)}", style="bold")
    for text in tally.violations:
        out.print(f"  {text}")


def _plain(tally: Tally) -> dict[str, Any]:
    return {
        **vars(tally),
        "faults": dict(tally.faults),
        "outcomes": dict(tally.outcomes),
        "restarts": dict(tally.restarts),
    }


def main() -> int:
    """Runs a campaign as told on the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=30.0, help="begin no round after that long (default 30)")
    parser.add_argument("--faults", type=int, default=10_000, help="inject no more than that many (default 10000)")
    parser.add_argument("--per-round", type=int, default=60, help="faults of one round (default 60)")
    parser.add_argument("--episodes", type=int, default=40, help="episodes of one round (default 40)")
    parser.add_argument("--workers", type=int, default=3, help="hosts (default 3)")
    parser.add_argument("--gateways", type=int, default=2, help="of every second round, 0 for none (default 2)")
    parser.add_argument("--seed", type=int, default=1, help="of the first round; the next ones count on (default 1)")
    parser.add_argument(
        "--simulation",
        choices=("fake", "real"),
        default="fake",
        help="fake: no physics, the protocol is on trial; real: the installed command line",
    )
    parser.add_argument("--root", type=Path, help="where to work; default: a temporary folder")
    parser.add_argument("--json", action="store_true", help="print the tally as JSON")
    told = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that nobody is left behind
    with tempfile.TemporaryDirectory(prefix="minivla-chaos-", dir=told.root) as folder:
        root = Path(folder)
        if told.simulation == "real":
            plan = root / "plan.toml"
            plan.write_text(_REAL_PLAN.format(episodes=told.episodes))
            casts = (real_cast(plan, told.episodes),)
        else:
            cast = fake_cast(told.episodes, 2.0)
            casts = (cast, fake_cast(told.episodes, 2.0, told.gateways)) if told.gateways else (cast,)
        tally = run_campaign(casts, root, told.workers, told.seed, told.minutes, told.faults, told.per_round)
        for path in root.glob("round-*.log"):
            shutil.copy(path, Path.cwd() / f"chaos-{path.name}")
    if told.json:
        sys.stdout.write(json.dumps(_plain(tally), indent=2) + "\n")
    else:
        _print(tally)
    return 1 if tally.violations else 0


if __name__ == "__main__":
    sys.exit(main())
