"""Benchmarks the coordinator: leases and submits on a large ledger, reopening it, validating and archiving bundles.

Calls ledger, validator and archive directly, then a complete coordinator over zenoh (`wire`). Simulates two episodes,
whose bundles are its samples.

    python -m tests.benchmarks.coordinator --jobs 1000000
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from coordinator.archive.opening import open_archive
from coordinator.expansion.catalog import Catalog
from coordinator.expansion.plan_file import load_plan
from coordinator.ledger import claims, outcomes
from coordinator.ledger.claims import lease_of
from coordinator.ledger.database.engine import open_writer
from coordinator.ledger.database.writer import Writer
from coordinator.ledger.opening import ledger_url_of, open_run
from coordinator.ledger.reading.progress import read_progress
from coordinator.validation.validator import Validator
from factory.bench.machine import describe_machine, measure_memory, resident_mib
from factory.bench.results import Machine, Memory, Spread
from factory.bench.tables import print_machine, progress_bar, range_text, round_digits
from factory.bench.workload import SAMPLE_PLAN, BenchSample, make_sample, narrow, temporary_folder
from factory.cli.options import count_option, json_option, pullers_option
from factory.runs.catalog import open_catalog
from factory.support.settings import scene_cache
from factory.support.terminal import print_result, print_table
from schemas.base import Model
from schemas.bundle import BundleReader
from schemas.dataset.rows import summary_of
from schemas.episode import EpisodeMeta
from schemas.plan import Plan
from schemas.protocol.messages import Done, Lease
from tests.benchmarks.command import run
from tests.benchmarks.wire import WireBench, bench_wire
from workers.sim.context import SimulationContext

_TTL_S = 600.0
_SID = "bench-1"
_SHA256 = "c" * 64
_ROUNDS = 8
"""Number of cycles of each worker in one repetition. A cycle is claim, announcement and archiving of one job."""


class CoordinatorBench(Model):
    """Result of the benchmark."""

    bench: str = "coordinator"
    machine: Machine
    jobs: int
    """Number of jobs in the ledger."""
    workers: int
    """Number of concurrent requests."""
    fill_s: float
    """Time to expand the plan and write its jobs, seconds."""
    cycles_per_s: Spread
    """Cycles of lease, announcement and archive per second of wall time, durable on disk."""
    reopen_s: Spread
    """Time to reopen the filled ledger and compare it with the plan, seconds."""
    progress_s: Spread
    """Time to read the progress of the filled ledger, seconds."""
    validate_ms_per_frame: Spread
    """Wall time to validate real bundles in the validation process, milliseconds per frame."""
    pullers: int
    """Number of validating processes that work at the same time."""
    validated_frames_per_s: Spread
    """Frames of real bundles per second of wall time, summed over the `pullers` validating processes."""
    archive_mb_per_s: Spread
    """Throughput of copy, hash, fsync and rename of real bundles, MB per second of wall time."""
    memory: Memory
    wire: WireBench


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


@click.command()
@count_option("--jobs", 100_000, "Number of jobs in the ledger.", least=1000, most=5_000_000)
@count_option("--workers", 64, "Number of concurrent simulated workers.", most=64)
@count_option("--sessions", 2000, "Number of concurrent network sessions.", most=4000)
@count_option("--bundle-mb", 32, "Size of each worker's bundle, MB.", most=256)
@pullers_option()
@count_option("--repeats", 3, "Number of timed runs; the result is their median.")
@json_option
def command(jobs: int, workers: int, sessions: int, bundle_mb: int, pullers: int, repeats: int, as_json: bool) -> None:
    """Measure a coordinator with a large ledger.

    Measures leases and submissions of real bundles, by direct calls and over the network. The memory is that of a
    separate coordinator process with all sessions connected, and while all workers send a bundle at the same time.
    """
    sample_plan = narrow(load_plan(SAMPLE_PLAN), ("office",), 2)
    part = sample_plan.scenes[0].model_copy(update={"episodes": jobs})
    plan = load_plan("paper").model_copy(update={"scenes": (part,)})
    with progress_bar("coordinator", 2) as tell, temporary_folder() as folder:
        catalog = open_catalog(sample_plan, folder, scene_cache())
        with SimulationContext() as stage:
            samples = make_sample(folder / "sample", sample_plan, catalog, stage, tell)
        report = bench_coordinator(
            plan,
            catalog,
            samples,
            folder,
            workers=workers,
            sessions=sessions,
            bundle_bytes=bundle_mb * 1_000_000,
            repeats=repeats,
            pullers=pullers,
        )
    print_result(report, as_json, _show)


def _show(report: CoordinatorBench) -> None:
    print_machine(report.machine)
    rows = [
        ("lease + announce + archive, cycles/s", report.cycles_per_s.median, range_text(report.cycles_per_s)),
        ("reopening the ledger, s", report.reopen_s.median, range_text(report.reopen_s)),
        ("reading the progress, s", report.progress_s.median, range_text(report.progress_s)),
        ("validation, ms per frame", report.validate_ms_per_frame.median, range_text(report.validate_ms_per_frame)),
        (
            f"validation by {report.pullers} pullers, frames/s",
            report.validated_frames_per_s.median,
            range_text(report.validated_frames_per_s),
        ),
        ("archiving, MB/s", report.archive_mb_per_s.median, range_text(report.archive_mb_per_s)),
        ("filling the ledger, s", report.fill_s, ""),
        ("resident memory at the end, MiB", report.memory.end_mib, f"peak {report.memory.peak_mib:.0f}"),
    ]
    title = f"{report.jobs} jobs, {report.workers} requests in flight"
    print_table(title, ("quantity", "median", "range"), rows)
    wire, sessions, deliveries = report.wire, report.wire.session_load, report.wire.delivery_load
    rows = [
        ("claim + announcement over zenoh, cycles/s", wire.cycles_per_s.median, range_text(wire.cycles_per_s)),
        (
            "small bundles archived during these cycles, 1/s",
            wire.archived_per_s.median,
            range_text(wire.archived_per_s),
        ),
        (
            "CPU time of the coordinator, ms per cycle",
            round_digits(wire.coordinator_cpu_ms.median),
            f"on a dedicated core: {1000 / wire.coordinator_cpu_ms.median:.0f} cycles/s",
        ),
        (
            "CPU time of the workers, ms per cycle",
            round_digits(wire.workers_cpu_ms.median),
            range_text(wire.workers_cpu_ms),
        ),
        ("start-up until it listens, s", wire.start_s.median, range_text(wire.start_s)),
        (
            f"memory with {sessions.sessions} sessions, MiB",
            sessions.memory.end_mib,
            f"peak {sessions.memory.peak_mib:.0f}",
        ),
        (
            f"{deliveries.workers} workers send {deliveries.bundle_mb:.0f} MB each, MB/s",
            deliveries.mb_per_s,
            f"{deliveries.seconds:.1f} s in total",
        ),
        ("peak memory during these deliveries, MiB", deliveries.memory.peak_mib, ""),
        (
            "claim of another worker during these deliveries, p99 ms",
            deliveries.claim_p99_ms,
            f"p50 {deliveries.claim_p50_ms:.1f}, n {deliveries.claims}",
        ),
    ]
    print_table("the same coordinator in a separate process", ("quantity", "value", "details"), rows)


if __name__ == "__main__":
    run(command)
