"""Generates the dataset of a finished run from a few recorded episodes: ledger, shards, tables. Simulates nothing.

Each episode is a copy of a recorded episode, with the job of a planned episode and slightly shifted poses, so no
two files are equal. Every twentieth episode has a failed attempt. Files, sizes and tables are like those of a run. The
content digests are wrong and the motion does not lead to the targets, so `factory verify --deep` reports errors.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xxhash

from coordinator.archive.opening import open_archive
from coordinator.expansion.catalog import Catalog
from coordinator.expansion.draw import PlannedJob, expand
from coordinator.ledger.database.engine import checkpoint_log, open_writer
from coordinator.ledger.opening import ledger_url_of, open_run
from coordinator.ledger.reading.reader import Connection
from coordinator.ledger.tables import episodes
from coordinator.tables.checkpoint import write_checkpoint
from coordinator.tables.split_tables import write_split_tables
from factory.bench.workload import BenchSample
from schemas.bundle import BundleReader, EpisodeArrays
from schemas.dataset.rows import EpisodeSummary, file_name_of, summary_of
from schemas.encoding.arrays import EPISODE_ARRAYS
from schemas.encoding.container import ContainerWriter
from schemas.encoding.ndarray import encode_npy
from schemas.episode import EpisodeMeta
from schemas.episode_spec import columns_of
from schemas.plan import Plan
from schemas.storage.dataset_files import EPISODES, SHARDS_FILE
from schemas.storage.shard_index import list_shards, write_index
from schemas.storage.shards import MAX_SHARD_EPISODES, range_of, shard_name, write_shard

_TTL_S = 600.0
_FAILS_EVERY = 20
_JITTER_M = 1e-3
_SETTLED = f"""
    UPDATE jobs SET state = 'archived', fence = attempt, sid = 'bench-1', token = lower(hex(randomblob(16))),
        (attempt, sha256, size, changed_at) = (SELECT e.attempt, e.sha256, e.size, e.archived_at FROM episodes AS e
            WHERE e.idx = jobs.idx);
    INSERT INTO attempts (job_id, idx, draw, attempt, fence, outcome, settles, detail, steps, seconds, sid, at)
        SELECT id, idx, draw, 1, 1, 'timeout', 1, 'timeout after 1000 steps', 1000, 5.0, sid, changed_at FROM jobs
            WHERE idx % {_FAILS_EVERY} = 0 UNION ALL
        SELECT id, idx, draw, attempt, attempt, 'success', 1, '', 200, 0.0, sid, changed_at FROM jobs;
    INSERT INTO events (at, job_id, event, state, attempt, fence, sid, detail)
        SELECT changed_at, id, 'claimed', 'leased', attempt, attempt, sid, '' FROM jobs UNION ALL
        SELECT changed_at, id, 'announced', 'submitted', attempt, attempt, sid, '' FROM jobs UNION ALL
        SELECT changed_at, id, 'archived', 'archived', attempt, attempt, sid, '' FROM jobs;
"""
"""SQL that records the attempts and events of all episodes in the table `episodes`."""


class _Recorded(NamedTuple):
    """Recorded episode."""

    meta: EpisodeMeta
    arrays: EpisodeArrays
    row: EpisodeSummary
    """Row of the episode in the metadata table."""
    text: bytes
    """JSON text of the fields that follow the field `job` in the `meta.json` of the episode."""


class _Made(NamedTuple):
    """Generated episode."""

    data: bytes
    """Content of its bundle."""
    row: EpisodeSummary
    """Row of the episode in the metadata table."""


def enlarge(plan: Plan, episodes: int) -> Plan:
    """Returns the plan with at least `episodes` episodes, in the same proportions."""
    times = -(-episodes // plan.episodes)
    scenes = (scene.model_copy(update={"episodes": scene.episodes * times}) for scene in plan.scenes)
    return plan.model_copy(update={"scenes": tuple(scenes)})


def make_synthetic(
    root: Path, plan: Plan, catalog: Catalog, samples: Sequence[BenchSample], tell: Callable[[int], None]
) -> None:
    """Writes a complete dataset.

    Args:
        root: Directory of the dataset, which does not exist.
        plan: Plan of the dataset, which records states.
        catalog: Scenes of the plan.
        samples: Recorded states episodes.
        tell: Progress callback, called with the number of episodes since the last call.
    """
    planned, now = expand(plan, catalog), datetime.now(UTC)
    with open_archive(root) as archive:
        for name, entry in catalog.items():
            archive.add_scene(entry.path, name, entry.sha256, entry.textures)
        engine = open_writer(ledger_url_of(root))
        try:
            open_run(engine, plan, catalog, _TTL_S, now, planned)
            made = _generate(plan, catalog, planned, [_read(sample.path) for sample in samples])
            while batch := list(islice(made, MAX_SHARD_EPISODES)):
                _pack(root, batch)
                with engine.begin() as connection:
                    connection.execute(episodes.insert(), [_ledger_row(found.row, now) for found in batch])
                tell(len(batch))
            with engine.begin() as connection:
                _settle(connection)
            with engine.connect() as connection:
                checkpoint_log(connection)
                write_checkpoint(archive, connection, plan, catalog, now)
        finally:
            engine.dispose()
        write_index(root / SHARDS_FILE, list_shards(root))
        write_split_tables(archive)


def _read(path: Path) -> _Recorded:
    with path.open("rb") as file, BundleReader(file) as bundle:
        meta, text = bundle.meta, bundle.meta.model_dump_json(exclude={"format", "episode_id", "job"})
        return _Recorded(meta, bundle.arrays, summary_of(meta, "0" * 64, 1), text.removeprefix("{").encode())


def _generate(
    plan: Plan, catalog: Catalog, planned: Sequence[PlannedJob], recorded: Sequence[_Recorded]
) -> Iterator[_Made]:
    rng = np.random.default_rng(plan.seed)
    for job in planned:
        scene = catalog[job.episode.scene].sha256
        of_run = {"run": plan.run, "plan_digest": plan.digest, "scene_sha256": scene}
        yield _make(recorded[job.index % len(recorded)], job, of_run, rng)


def _make(recorded: _Recorded, planned: PlannedJob, of_run: dict[str, str], rng: np.random.Generator) -> _Made:
    index, arrays = planned.index, recorded.arrays
    numbers = {"index": index, "draw": planned.draw, "attempt": 1 if index % _FAILS_EVERY else 2}
    job = recorded.meta.job.model_copy(update={**dict(planned.episode), **of_run, **numbers})
    poses = arrays.poses + rng.normal(0.0, _JITTER_M, (len(arrays.poses), 1)) * (1, 1, 0, 0, 0, 0, 0)
    name = job.episode_id
    head = f'{{"format": {recorded.meta.format}, "episode_id": "{name}", "job": {job.model_dump_json()}, '
    file = BytesIO()
    with ContainerWriter(file) as out:
        for spec, array in zip(EPISODE_ARRAYS, (*arrays.in_order()[:-1], poses), strict=True):
            out.add(f"{spec.name}.npy", encode_npy(array))
        out.add("meta.json", head.encode() + recorded.text)
    data = file.getvalue()
    changes: dict[str, Any] = {
        **columns_of(planned.episode, EpisodeSummary),
        **of_run,
        **numbers,
        "episode_id": name,
        "content_digest": xxhash.xxh3_128_hexdigest(data),
        "file_sha256": hashlib.sha256(data).hexdigest(),
        "file_bytes": len(data),
        "file_name": file_name_of(name),
        "spawn_x_m": float(poses[0, 0]),
        "spawn_y_m": float(poses[0, 1]),
        "trajectory_length_m": recorded.row.trajectory_length_m + float(poses[-1, 0] - poses[-2, 0]) ** 2,
    }
    return _Made(data, recorded.row.model_copy(update=changes))


def _pack(root: Path, batch: Sequence[_Made]) -> None:
    file = BytesIO()
    write_shard(file, ((found.row.index, found.data) for found in batch))
    data = file.getvalue()
    name = shard_name(*range_of(batch[0].row.index), hashlib.sha256(data).hexdigest())
    (root / EPISODES / name).write_bytes(data)


def _ledger_row(row: EpisodeSummary, now: datetime) -> dict[str, Any]:
    return {
        "idx": row.index,
        "job_id": row.index,  # in a new ledger, the job of an episode has the episode's number
        "attempt": row.attempt,
        "sha256": row.file_sha256,
        "size": row.file_bytes,
        "content_digest": row.content_digest,
        "summary": row.model_dump_json(),
        "archived_at": now.timestamp(),
    }


def _settle(connection: Connection) -> None:
    for statement in _SETTLED.split(";"):
        if statement.strip():
            connection.exec_driver_sql(statement)
