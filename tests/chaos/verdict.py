"""What is wrong with a run once everybody has left: lost, doubled, torn, forgotten. Looks only; mends nothing."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator
from datetime import UTC, datetime

from coordinator.gateway.gather import gather
from coordinator.recovery.repair_dataset import RepairInput, repair
from coordinator.validation.validator import Validator
from schemas.encoding.digest import dataset_digest
from tests.builders.ledger import room_catalog, room_plan
from tests.chaos.cluster import FAULTY_HOST, ChaosCluster
from tests.chaos.hostile_peer import HOSTILE_HOST

__all__ = ["digest_of", "gathering_of", "violations_of"]


def digest_of(party: ChaosCluster) -> str:
    """Returns the digest of the dataset."""
    return dataset_digest((str(index), digest) for index, digest in party.archived().items())


def gathering_of(party: ChaosCluster) -> Iterator[str]:
    """Brings together what gateways keep, so that the dataset is whole; yields what cannot be had."""
    if not party.gateways:
        return
    report = gather(_patient(party), party.stores, datetime.now(UTC))
    yield from (f"{one.episode} is not whole at {one.gateway}: {one.why}" for one in report.missing)
    for store in party.stores:
        parts = list((store / ".staging").iterdir())
        if parts:
            yield f"part files are left in {store.name}"


def violations_of(party: ChaosCluster) -> Iterator[str]:
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
    yield from _ended_badly(party)
    yield from _disagreements(party)


def _ended_badly(party: ChaosCluster) -> Iterator[str]:
    """Jobs without an episode, and honest hosts that get no more jobs."""
    for index, state, reason in party.query(
        "select idx, state, reason from jobs where not superseded and state != 'archived'"
    ):
        yield f"episode {index} ended as {state}: {reason}"
    for host, reason in party.query("select host, reason from hosts where barred_at is not null"):
        if host not in {FAULTY_HOST, HOSTILE_HOST}:
            yield f"honest host {host} is barred: {reason}"


def _disagreements(party: ChaosCluster) -> Iterator[str]:
    """What `factory repair` would find between files, ledger and tables; only for the run whose scene is synthetic."""
    if not party.cast.has_small_disk:
        return
    with Validator() as validator:
        report = repair(_patient(party), validator, datetime.now(UTC), apply=False)
    yield from (f"{action.kind} {action.what}: {action.why}" for action in report.actions)


def _patient(party: ChaosCluster) -> RepairInput:
    plan, catalog = room_plan(party.cast.episodes, crashes=party.cast.crashes), room_catalog(party.place)
    return RepairInput(party.out, party.out, f"sqlite:///{party.out / 'ledger.db'}", plan, catalog, {})
