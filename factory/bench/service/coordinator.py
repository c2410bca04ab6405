"""Benchmarks the coordinator: leases and submits on a large ledger, reopening it, validating and archiving bundles.

Calls ledger, validator and archive directly, then a complete coordinator over zenoh (`wire`). Runs no simulation.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from coordinator.archive.opening import open_archive
from coordinator.expansion.catalog import Catalog
from coordinator.ledger import claims, outcomes
from coordinator.ledger.claims import lease_of
from coordinator.ledger.database.engine import open_writer
from coordinator.ledger.database.writer import Writer
from coordinator.ledger.opening import ledger_url_of, open_run
from coordinator.ledger.reading.progress import read_progress
from coordinator.validation.validator import Validator
from factory.bench.machine import describe_machine, measure_memory, resident_mib
from factory.bench.results import CoordinatorBench, Spread
from factory.bench.service.wire import bench_wire
from factory.bench.workload import BenchSample
from schemas.bundle import BundleReader
from schemas.dataset.rows import summary_of
from schemas.episode import EpisodeMeta
from schemas.plan import Plan
from schemas.protocol.messages import Done, Lease

_TTL_S = 600.0
_SID = "bench-1"
_SHA256 = "c" * 64
_ROUNDS = 8
"""Number of cycles of each worker in one repetition. A cycle is claim, announcement and archiving of one job."""


def bench_coordinator(
    plan: Plan,
    catalog: Catalog,
    samples: Sequence[BenchSample],
    folder: Path,
    *,
    workers: int,
    sessions: int,
    bundle_bytes: int,
    repeats: int,
    pullers: int,
) -> CoordinatorBench:
    """Fills a ledger with the jobs of a plan, runs the load of many workers on it, and returns the measurements.

    Args:
        plan: Plan whose number of episodes sets the size of the ledger.
        catalog: Scenes of the plan.
        samples: Real bundles to validate and archive.
        folder: Empty directory for the ledger and an archive.
        workers: Number of concurrent requests.
        sessions: Number of simultaneous sessions for the memory measurement.
        bundle_bytes: Size of the bundle that each worker delivers when all finish together, bytes.
        repeats: Number of repetitions. The ledger is filled once; sessions and simultaneous deliveries are measured
            once.
        pullers: Number of validating processes that work at the same time.
    """
    machine, start_mib = describe_machine(), resident_mib()
    with samples[0].path.open("rb") as file:
        meta = BundleReader(file).meta
    fill_s = _seconds(lambda: _open(plan, catalog, folder).dispose())
    reopened = [_seconds(lambda: _open(plan, catalog, folder).dispose()) for _ in range(repeats)]
    engine = _open(plan, catalog, folder)
    with Writer(engine) as writer:
        cycles = [_cycles_per_s(writer, meta, workers) for _ in range(repeats)]
        looks = [_seconds(lambda: writer.call(lambda c: read_progress(c, datetime.now(UTC)))) for _ in range(repeats)]
    memory = measure_memory(start_mib)
    engine.dispose()
    wire = bench_wire(
        plan, catalog, meta, folder, workers=workers, sessions=sessions, bundle_bytes=bundle_bytes, repeats=repeats
    )
    return CoordinatorBench(
        machine=machine,
        jobs=plan.episodes,
        workers=workers,
        fill_s=fill_s,
        cycles_per_s=Spread.of(cycles),
        reopen_s=Spread.of(reopened),
        progress_s=Spread.of(looks),
        validate_ms_per_frame=Spread.of(_validate(samples, repeats)),
        pullers=pullers,
        validated_frames_per_s=Spread.of(_validate_together(samples, pullers, repeats)),
        archive_mb_per_s=Spread.of([_archive(samples, folder / f"archive{n}") for n in range(repeats)]),
        memory=memory,
        wire=wire,
    )


def _seconds(work: Callable[[], Any]) -> float:
    start_s = time.perf_counter()
    work()
    return time.perf_counter() - start_s


def _open(plan: Plan, catalog: Catalog, folder: Path) -> Any:
    engine = open_writer(ledger_url_of(folder))
    open_run(engine, plan, catalog, _TTL_S, datetime.now(UTC))
    return engine


def _cycles_per_s(writer: Writer, meta: EpisodeMeta, workers: int) -> float:
    """Returns the cycles per second.

    In each round, all workers claim a job; when all have one, they announce their bundles; then the bundles are
    archived.
    """
    start_s = time.perf_counter()
    for _ in range(_ROUNDS):
        rows = _together(writer, [_claim] * workers)
        leases = [lease_of(row) for row in rows]
        _together(writer, [_announcing(lease) for lease in leases])
        _together(writer, [archiving(lease, row.idx, meta) for lease, row in zip(leases, rows, strict=True)])
    return _ROUNDS * workers / (time.perf_counter() - start_s)


def _together(writer: Writer, works: Sequence[Callable[[Any], Any]]) -> list[Any]:
    futures: list[Future[Any]] = [writer.submit(work) for work in works]
    return [future.result() for future in futures]


def _claim(connection: Any) -> Any:
    return claims.claim(connection, _SID, secrets.token_hex(16), datetime.now(UTC), _TTL_S)


def _announcing(lease: Lease) -> Callable[[Any], Any]:
    done = Done(sid=_SID, lease=lease, sha256=_SHA256, size=1000)
    return lambda connection: outcomes.announce(connection, done, datetime.now(UTC), _TTL_S)


def archiving(lease: Lease, index: int, meta: EpisodeMeta) -> Callable[[Any], Any]:
    """Returns a function that records an archived episode, for the writer of the ledger."""
    job = meta.job.model_copy(update={"index": index})
    summary = summary_of(meta.model_copy(update={"job": job, "episode_id": job.episode_id}), _SHA256, 1000)
    return lambda connection: outcomes.archive(connection, lease, summary, datetime.now(UTC))


def _validate(samples: Sequence[BenchSample], repeats: int) -> list[float]:
    with Validator() as validator:
        validator.check(samples[0].path, samples[0].job)  # the first check starts the validation process
        frames = 0
        runs = []
        for _ in range(repeats):
            start_s = time.perf_counter()
            frames = sum(validator.check(sample.path, sample.job).num_steps for sample in samples)
            runs.append(1000 * (time.perf_counter() - start_s) / frames)
    return runs


def _validate_together(samples: Sequence[BenchSample], pullers: int, repeats: int) -> list[float]:
    """Returns the total frames per second of several processes, each of which validates all samples."""
    with Validator(pullers) as validator, ThreadPoolExecutor(pullers) as pool:

        def check_all() -> int:
            return sum(validator.check(sample.path, sample.job).num_steps for sample in samples)

        def frames() -> int:
            return sum(each.result() for each in [pool.submit(check_all) for _ in range(pullers)])

        count = frames()  # the first checks start the processes
        return [count / _seconds(frames) for _ in range(repeats)]


def _archive(samples: Sequence[BenchSample], root: Path) -> float:
    bundles = [sample.path.read_bytes() for sample in samples]
    with open_archive(root) as archive:
        start_s = time.perf_counter()
        for sample, data in zip(samples, bundles, strict=True):
            with archive.stage(sample.job.index) as staged:
                staged.write(data)
                archive.publish(staged, sample.job.index)
        return sum(map(len, bundles)) / 1e6 / (time.perf_counter() - start_s)
