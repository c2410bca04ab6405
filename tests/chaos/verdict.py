"""Finds lost, duplicated, damaged and leftover data of an ended run. Repairs nothing."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator
from datetime import UTC, datetime

from coordinator.gateway.gather import gather
from coordinator.recovery.repair_dataset import RepairInput, repair
from coordinator.validation.validator import Validator
from schemas.encoding.digest import dataset_digest
from schemas.storage.episode_list import list_episodes
from schemas.storage.packed_path import PackedPath
from schemas.terms import Recording
from tests.builders.ledger import room_catalog
from tests.builders.room_coordinator import SHARD_EPISODES
from tests.chaos.cluster import FAULTY_HOST, ChaosCluster
from tests.chaos.hostile_peer import HOSTILE_HOST


def digest_of(cluster: ChaosCluster) -> str:
    """Returns the digest of the dataset."""
    return dataset_digest((str(index), digest) for index, digest in cluster.archived().items())


def gather_problems(cluster: ChaosCluster) -> Iterator[str]:
    """Gathers the episodes of the gateways into the dataset; yields missing episodes and leftover part files."""
    if not cluster.gateways:
        return
    report = gather(_repair_input(cluster), cluster.stores, datetime.now(UTC), shard_episodes=SHARD_EPISODES)
    yield from (f"{one.episode} is not intact at {one.gateway}: {one.why}" for one in report.missing)
    for store in cluster.stores:
        parts = list((store / ".staging").iterdir())
        if parts:
            yield f"part files are left in {store.name}"


def violations_of(cluster: ChaosCluster) -> Iterator[str]:
    """Yields a text for each loss, duplicate, damaged episode and leftover of an ended run."""
    wanted = set(range(1, cluster.commands.episodes + 1))
    listed = list_episodes(cluster.out)
    files = listed.episodes
    if set(files) != wanted:
        yield f"files of {len(files)} episodes ({sorted(files)[:5]}...), expected 1 to {len(wanted)}"
    unpacked = [index for index, path in files.items() if not isinstance(path, PackedPath)]
    if cluster.commands.record is Recording.STATES and unpacked:
        yield f"episodes {unpacked[:5]} are not packed"
    for index, sha256 in cluster.query("select idx, sha256 from episodes"):
        path = files.get(index)
        if path is not None and hashlib.sha256(path.read_bytes()).hexdigest() != sha256:
            yield f"episode {index} is torn"
    if cluster.outcomes()["success"] != len(wanted):
        yield f"{cluster.outcomes()['success']} successes recorded for {len(wanted)} episodes"
    gained = Counter(
        dict(cluster.query("select job_id, count(*) from events where state = 'archived' group by job_id"))
    )
    lost = Counter(dict(cluster.query("select job_id, count(*) from events where event = 'lost' group by job_id")))
    duplicated = [job for job in gained if gained[job] - lost[job] != 1]
    if duplicated:
        yield f"jobs {duplicated[:5]} archived more than once"
    if list((cluster.out / ".staging").iterdir()):
        yield "part files are left"
    for held in cluster.query("select idx, state from jobs where state in ('leased', 'submitted')"):
        yield f"episode {held[0]} is still {held[1]}"
    yield from _failed_jobs(cluster)
    yield from _inconsistencies(cluster)


def _failed_jobs(cluster: ChaosCluster) -> Iterator[str]:
    """Yields jobs without an episode and barred honest hosts."""
    for index, state, reason in cluster.query(
        "select idx, state, reason from jobs where not superseded and state != 'archived'"
    ):
        yield f"episode {index} ended as {state}: {reason}"
    for host, reason in cluster.query("select host, reason from hosts where barred_at is not null"):
        if host not in {FAULTY_HOST, HOSTILE_HOST}:
            yield f"honest host {host} is barred: {reason}"


def _inconsistencies(cluster: ChaosCluster) -> Iterator[str]:
    """Yields what `factory repair` would change; only for a run with a synthetic scene."""
    if not cluster.commands.has_small_disk:
        return
    with Validator() as validator:
        report = repair(_repair_input(cluster), validator, datetime.now(UTC), apply=False)
    yield from (f"{action.kind} {action.what}: {action.why}" for action in report.actions)


def _repair_input(cluster: ChaosCluster) -> RepairInput:
    url, catalog = f"sqlite:///{cluster.out / 'ledger.db'}", room_catalog(cluster.place)
    return RepairInput(cluster.out, cluster.out, url, cluster.commands.plan, catalog, {})
