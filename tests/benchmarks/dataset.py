"""Benchmarks a large dataset of states: open, filter, sample, verify, checkpoint and status. Generates no dataset.

Each part runs in a fresh process, whose peak memory is part of the result.

    python -m tests.benchmarks.dataset --episodes 20000
"""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

import click
import numpy as np

from coordinator.archive.opening import open_archive
from coordinator.expansion.plan_file import load_plan, shrink
from coordinator.ledger import outcomes
from coordinator.ledger.database.engine import open_reader, open_writer
from coordinator.ledger.opening import ledger_url_of
from coordinator.ledger.reading.audit import ledger_trouble
from coordinator.ledger.reading.progress import read_progress
from coordinator.tables.checkpoint import Checkpoints
from factory.bench.machine import describe_machine, measure_memory, resident_mib
from factory.bench.results import Machine, Memory
from factory.bench.tables import print_machine
from factory.bench.workload import SAMPLE_PLAN, make_sample, narrow, temporary_folder
from factory.cli.options import count_option, json_option
from factory.dataset.reader import Dataset
from factory.runs.catalog import open_catalog
from factory.runs.scene_packages import find_package
from factory.support.settings import scene_cache
from factory.support.terminal import Bars, print_result, print_table
from factory.verify.dataset import verify
from schemas.base import Model
from schemas.terms import Recording
from tests.benchmarks.command import run
from tests.benchmarks.synthetic import enlarge, make_synthetic
from workers.sim.context import SimulationContext

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
    """Result of the benchmark."""

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


@click.command()
@count_option("--episodes", 20_000, "Number of episodes; each needs 16 kB of disk, ledger and tables included.")
@count_option("--reads", 2000, "Number of random episodes to read.")
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="New directory in which the dataset is kept. Default: the dataset is deleted.",
)
@json_option
def command(episodes: int, reads: int, out: Path | None, as_json: bool) -> None:
    """Measure a large dataset of states.

    Generates a dataset from a few simulated episodes, then measures opening, filtering, random access, verification,
    status and checkpoints.
    """
    sample_plan = shrink(narrow(load_plan(SAMPLE_PLAN), (), 2), record=Recording.STATES)
    plan = shrink(enlarge(load_plan("paper"), episodes), record=Recording.STATES, episodes=episodes)
    with temporary_folder() as folder, Bars(refresh_per_second=1) as bar:
        catalog = open_catalog(sample_plan, folder, scene_cache())
        with SimulationContext() as stage:
            task = bar.add_task("bench sample", total=sample_plan.episodes)
            samples = make_sample(folder / "sample", sample_plan, catalog, stage, lambda: bar.advance(task))
        task = bar.add_task("bench dataset", total=episodes)
        start_s = time.perf_counter()
        data = folder / "data" if out is None else out
        make_synthetic(data, plan, catalog, samples, lambda count: bar.advance(task, count))
        report = bench_dataset(data, reads, time.perf_counter() - start_s)
    print_result(report, as_json, _show)


def _show(report: DatasetBench) -> None:
    print_machine(report.machine)
    reader, verification, checkpoint = report.reader, report.verification, report.checkpoint
    rows = [
        ("generating, s", report.generate_s, ""),
        ("opening, s", reader.open_s, _peak(reader.opened)),
        ("selecting a split and a tier, s", reader.filter_s, ""),
        ("first episode, s", reader.first_episode_s, ""),
        ("random episodes/s", reader.episodes_per_s, _peak(reader.memory)),
        ("random episodes/CPU s", reader.episodes_per_cpu_s, ""),
        ("digest, s", reader.digest_s, ""),
        (f"verification, {verification.findings} findings, s", verification.seconds, _peak(verification.memory)),
        ("status, s", report.ledger.status_s, ""),
        ("audit at the start of a coordinator, s", report.ledger.audit_s, ""),
        ("first checkpoint of a process, s", checkpoint.rewrite_s, _peak(checkpoint.memory)),
        ("checkpoint after 50 changes, s", checkpoint.changed_s, ""),
        ("checkpoint without changes, s", checkpoint.unchanged_s, ""),
    ]
    title = f"{report.episodes} states episodes, {report.files} files, {report.gigabytes:.2f} GB"
    print_table(title, ("quantity", "value", "memory"), rows)


def _peak(memory: Memory) -> str:
    return f"peak {memory.peak_mib:.0f} MiB"


if __name__ == "__main__":
    run(command)
