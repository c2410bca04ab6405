"""Benchmarks a large dataset of states: open, filter, sample, verify, checkpoint and status. Generates no dataset.

Each part runs in a fresh process, whose peak memory is part of the result.
"""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

import numpy as np

from coordinator.archive.opening import open_archive
from coordinator.ledger import outcomes
from coordinator.ledger.database.engine import open_reader, open_writer
from coordinator.ledger.opening import ledger_url_of
from coordinator.ledger.reading.audit import ledger_trouble
from coordinator.ledger.reading.progress import read_progress
from coordinator.tables.checkpoint import Checkpoints
from factory.bench.machine import describe_machine, measure_memory, resident_mib
from factory.bench.results import Machine, Memory
from factory.dataset.reader import Dataset
from factory.runs.scene_packages import find_package
from factory.verify.dataset import verify
from schemas.base import Model

_SEED = 20
_CHANGED = 50
"""Number of episodes that change between two checkpoints, as in a busy run."""
Result = TypeVar("Result")


class ReaderCost(Model):
    """Cost of reading a large dataset in one process."""

    open_s: float
    """Time to open the dataset, seconds."""
    opened: Memory
    """Memory after the dataset was opened."""
    filter_s: float
    """Time to select a split and a tier, seconds."""
    first_episode_s: float
    """Time to find the first episode, seconds; includes reading its row of the metadata."""
    episodes_per_s: float
    """Random episodes per second of wall time: row, metadata, arrays and instances."""
    episodes_per_cpu_s: float
    """Random episodes per second of CPU time."""
    memory: Memory
    """Memory after the random episodes were read."""
    digest_s: float
    """Time to compute the digest of the dataset, seconds."""


class VerifyCost(Model):
    """Cost of a verification without `--deep`."""

    seconds: float
    findings: int
    memory: Memory


class LedgerCost(Model):
    """Cost of reading a large ledger."""

    status_s: float
    """Time to read the progress, seconds."""
    audit_s: float
    """Time of the audit at the start of a coordinator, seconds."""


class CheckpointCost(Model):
    """Cost of writing the tables."""

    rewrite_s: float
    """Time of the first checkpoint of a process, which reads every row, seconds."""
    changed_s: float
    """Time of a checkpoint after 50 episodes changed, seconds."""
    unchanged_s: float
    """Time of a checkpoint without a change, seconds."""
    memory: Memory
    """Memory after the first checkpoint."""


class DatasetBench(Model):
    """Result of `factory bench dataset`."""

    bench: str = "dataset"
    machine: Machine
    episodes: int
    files: int
    """Number of files in the directory of the dataset, including the ledger."""
    gigabytes: float
    """Size of these files, GB (1e9 bytes)."""
    generate_s: float
    """Time to generate the dataset, seconds."""
    reader: ReaderCost
    verification: VerifyCost
    ledger: LedgerCost
    checkpoint: CheckpointCost


def bench_dataset(root: Path, reads: int, generate_s: float) -> DatasetBench:
    """Measures a finished dataset with a ledger. The last part changes the ledger.

    Args:
        root: Directory of the dataset.
        reads: Number of random episodes to read.
        generate_s: Time that the generation of the dataset took, seconds.
    """
    machine = describe_machine()
    files = [path for path in root.rglob("*") if path.is_file()]
    return DatasetBench(
        machine=machine,
        episodes=len(Dataset(root)),
        files=len(files),
        gigabytes=round(sum(path.stat().st_size for path in files) / 1e9, 3),
        generate_s=round(generate_s, 1),
        reader=_alone(_read, root, reads),
        verification=_alone(_verify, root),
        ledger=_alone(_read_status, root),
        checkpoint=_alone(_checkpoint, root),
    )


def _alone(measure: Callable[..., Result], *arguments: object) -> Result:
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as process:
        return process.submit(measure, *arguments).result()


def _seconds(work: Callable[[], object]) -> float:
    start_s = time.perf_counter()
    work()
    return round(time.perf_counter() - start_s, 4)


def _read(root: Path, reads: int) -> ReaderCost:
    start_mib = resident_mib()
    open_s = _seconds(lambda: Dataset(root))
    opened = measure_memory(start_mib)
    dataset = Dataset(root)
    filter_s = _seconds(lambda: dataset.filter(split="train_id", tier="near"))
    first_s = _seconds(lambda: dataset[0])
    positions = np.random.default_rng(_SEED).integers(len(dataset), size=reads).tolist()
    _read_episode(dataset, 0)  # not timed, because the first access takes longer
    start_s, start_cpu_s = time.perf_counter(), time.process_time()
    for position in positions:
        _read_episode(dataset, position)
    wall_s, cpu_s = time.perf_counter() - start_s, time.process_time() - start_cpu_s
    return ReaderCost(
        open_s=open_s,
        opened=opened,
        filter_s=filter_s,
        first_episode_s=first_s,
        episodes_per_s=round(reads / wall_s, 1),
        episodes_per_cpu_s=round(reads / cpu_s, 1),
        memory=measure_memory(start_mib),
        digest_s=_seconds(lambda: dataset.digest),
    )


def _read_episode(dataset: Dataset, position: int) -> None:
    with dataset[position] as episode:
        _ = episode.summary, episode.actions, episode.meta, episode.instances


def _verify(root: Path) -> VerifyCost:
    start_mib = resident_mib()
    start_s = time.perf_counter()
    report = verify(root)
    took_s = time.perf_counter() - start_s
    return VerifyCost(seconds=round(took_s, 2), findings=len(report.findings), memory=measure_memory(start_mib))


def _read_status(root: Path) -> LedgerCost:
    engine = open_reader(ledger_url_of(root))
    try:
        with engine.connect() as connection:
            status_s = _seconds(lambda: read_progress(connection, datetime.now(UTC)))
    finally:
        engine.dispose()
    return LedgerCost(status_s=status_s, audit_s=_seconds(lambda: ledger_trouble(ledger_url_of(root))))


def _checkpoint(root: Path) -> CheckpointCost:
    start_mib = resident_mib()
    meta, now = Dataset(root).meta, datetime.now(UTC)
    plan, catalog = meta.plan, {name: find_package(root, name, sha256) for name, sha256 in meta.scenes.items()}
    engine = open_writer(ledger_url_of(root))
    try:
        with open_archive(root) as archive:
            checkpoints = Checkpoints(archive, plan, catalog)

            def write() -> None:
                with engine.connect() as connection:
                    checkpoints.write(connection, now)

            rewrite_s = _seconds(write)
            rewritten = measure_memory(start_mib)
            with engine.begin() as connection:
                for index in range(plan.episodes, plan.episodes - _CHANGED, -1):
                    outcomes.lose(connection, index, now, "changed by the benchmark")
            return CheckpointCost(
                rewrite_s=rewrite_s, changed_s=_seconds(write), unchanged_s=_seconds(write), memory=rewritten
            )
    finally:
        engine.dispose()
