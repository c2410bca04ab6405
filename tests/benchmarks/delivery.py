"""Measures how many valid bundles a coordinator archives, for several shares of spot checks.

Each variant starts a coordinator on a new ledger and a process of simulated workers, which deliver copies of two
episodes.

    python -m tests.benchmarks.delivery --episodes 40
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple, Self

import click

from coordinator.expansion.catalog import Catalog
from coordinator.expansion.draw import PlannedJob, to_job
from coordinator.expansion.plan_file import load_plan, shrink
from coordinator.ledger.archived import count_unchecked
from coordinator.ledger.database.engine import open_reader, open_writer
from coordinator.ledger.opening import ledger_url_of, open_run
from coordinator.settings import CoordinatorSettings
from factory.bench.machine import describe_machine
from factory.bench.results import Machine
from factory.bench.tables import progress_bar
from factory.bench.workload import SAMPLE_PLAN, BenchSample, make_sample, narrow, temporary_folder
from factory.cli.options import count_option, json_option, pullers_option, record_option
from factory.runs.catalog import open_catalog
from factory.support.settings import scene_cache
from factory.support.terminal import print_result, print_table
from schemas.base import Model
from schemas.episode_spec import EpisodeSpec
from schemas.plan import Plan
from schemas.terms import Recording
from tests.benchmarks.command import run
from tests.benchmarks.coordinator_process import CoordinatorReady, serve_archive
from tests.benchmarks.delivery_fleet import RecordedBundle, deliver_copies
from tests.benchmarks.wire import process, receive, usage
from workers.sim.context import SimulationContext

_LEASE_S = 600.0
_WAITING = 512
"""Largest number of bundles that wait for the coordinator, summed over all workers."""
_WAITING_BYTES = 1 << 30
"""Largest total size of the bundles that wait for the coordinator, bytes."""
_READY_BYTES = 1 << 29
"""Threshold of the total size of all bundles, bytes. Below it, all bundles are made before the measurement; otherwise,
each bundle is made when its job is claimed."""


class DeliveryCost(NamedTuple):
    """Measurement of one variant."""

    seconds: float
    """Wall time, seconds."""
    cpu_s: float
    """CPU time of the coordinator and its validating processes, seconds."""
    unchecked: int
    """Number of archived episodes whose frames only their worker has validated."""


class DeliveryPace(Model):
    """Pace of a coordinator that archives valid bundles; CPU times include its validating processes."""

    pullers: int
    """Number of bundles that are transferred and validated at the same time."""
    spot_checks: float | None
    """Share of the bundles validated by workers that the coordinator validates completely again. `None`: the
    coordinator validates all bundles."""
    validated: int
    """Number of episodes that the coordinator validated completely."""
    seconds: float
    """Wall time, seconds; the simulated workers use the same cores."""
    cpu_s: float
    """CPU time of the coordinator, seconds."""
    frames_per_s: float
    """Archived frames per second of wall time."""
    frames_per_cpu_s: float
    """Archived frames per second of CPU time."""
    episodes_per_s: float
    """Archived episodes per second of wall time."""
    episodes_per_cpu_s: float
    """Archived episodes per second of CPU time."""

    @classmethod
    def of(cls, settings: CoordinatorSettings, frames: int, episodes: int, cost: DeliveryCost) -> Self:
        """Returns the pace of a variant from its measurement and the number of archived frames and episodes."""
        seconds, cpu_s, unchecked = cost
        return cls(
            pullers=settings.pullers,
            spot_checks=settings.spot_checks,
            validated=episodes - unchecked,
            seconds=seconds,
            cpu_s=cpu_s,
            frames_per_s=frames / seconds,
            frames_per_cpu_s=frames / cpu_s,
            episodes_per_s=episodes / seconds,
            episodes_per_cpu_s=episodes / cpu_s,
        )


class DeliveryBench(Model):
    """Result of the benchmark."""

    bench: str = "delivery"
    machine: Machine
    record: Recording
    episodes: int
    """Number of archived episodes of each variant."""
    frames: int
    """Number of steps of these episodes."""
    mb_per_episode: float
    """Mean size of a bundle, MB (1e6 bytes)."""
    workers: int
    """Number of simulated workers."""
    paces: tuple[DeliveryPace, ...]
    """Pace of each variant; the variants differ in the share of spot checks."""


def bench_delivery(
    plan: Plan,
    catalog: Catalog,
    samples: Sequence[BenchSample],
    folder: Path,
    *,
    episodes: int,
    workers: int,
    pullers: int,
    shares: Sequence[float | None],
    tell: Callable[[], None],
) -> DeliveryBench:
    """Archives copies of recorded episodes and returns the measurements.

    A measurement includes claims, announcements, heartbeats, transfer, validation, fsyncs and ledger. It excludes the
    tables of the dataset and the log, and the CPU time excludes that of the simulated workers. Before the measurement,
    each worker delivers one bundle, because the coordinator validates the first bundle of a host completely.

    Args:
        plan: Plan of the samples.
        catalog: Scenes of the plan.
        samples: Recorded episodes.
        folder: Empty directory for the datasets.
        episodes: Number of measured episodes of each variant.
        workers: Number of simulated workers.
        pullers: Number of pullers.
        shares: Shares of spot checks to compare; `None` validates all bundles centrally.
        tell: Progress callback, called after every variant.
    """
    machine, paces = describe_machine(), []
    jobs = episodes + workers  # each worker delivers one bundle before the measurement
    plan = plan.model_copy(update={"scenes": (plan.scenes[0].model_copy(update={"episodes": jobs}),)})
    recordings = [RecordedBundle(sample.path) for sample in samples]
    steps = [recording.meta.rollout.num_steps for recording in recordings]
    frames = sum(steps[index % len(steps)] for index in range(workers + 1, jobs + 1))
    sizes = [sample.path.stat().st_size for sample in samples]
    for number, share in enumerate(shares):
        root = folder / f"run{number}"
        _fill(root, plan, catalog, recordings)
        settings = CoordinatorSettings(
            lease_ttl_s=_LEASE_S, reserve_bytes=0, checkpoint_s=_LEASE_S, pullers=pullers, spot_checks=share
        )
        cost = _archive_copies(root, plan, catalog, settings, samples, workers)
        paces.append(DeliveryPace.of(settings, frames, episodes, cost))
        tell()
    return DeliveryBench(
        machine=machine,
        record=plan.record,
        episodes=episodes,
        frames=frames,
        mb_per_episode=sum(sizes) / len(sizes) / 1e6,
        workers=workers,
        paces=tuple(paces),
    )


def _archive_copies(
    root: Path,
    plan: Plan,
    catalog: Catalog,
    settings: CoordinatorSettings,
    samples: Sequence[BenchSample],
    workers: int,
) -> DeliveryCost:
    """Returns the measurement of a coordinator that archives the planned episodes."""
    paths = [sample.path for sample in samples]
    largest = max(path.stat().st_size for path in paths)
    planned = _planned(plan, [RecordedBundle(path) for path in paths]) if largest * plan.episodes < _READY_BYTES else ()
    jobs = [to_job(plan, catalog, each, attempt=1) for each in planned]
    at_once = max(2, min(_WAITING, _WAITING_BYTES // largest) // workers)
    with process(serve_archive, root, plan, catalog, settings, samples[0]) as coordinator:
        opened: CoordinatorReady = receive(coordinator)
        load = (opened.endpoints, plan.run, workers, paths, jobs, settings.spot_checks is not None, at_once)
        with process(deliver_copies, *load) as fleet:
            receive(fleet)
            before = usage(coordinator).cpu_s
            fleet.send("go")
            seconds: float = receive(fleet)
            cpu_s = usage(coordinator).cpu_s - before
    engine = open_reader(ledger_url_of(root))
    with engine.connect() as connection:
        unchecked = count_unchecked(connection)
    engine.dispose()
    return DeliveryCost(seconds, cpu_s, unchecked)


def _fill(root: Path, plan: Plan, catalog: Catalog, recordings: Sequence[RecordedBundle]) -> None:
    """Creates a ledger. Each of its jobs is a copy of the job of a recording; the recordings are used in turn."""
    root.mkdir()
    engine = open_writer(ledger_url_of(root))
    open_run(engine, plan, catalog, _LEASE_S, datetime.now(UTC), _planned(plan, recordings))
    engine.dispose()


def _planned(plan: Plan, recordings: Sequence[RecordedBundle]) -> Iterator[PlannedJob]:
    for index in range(1, plan.episodes + 1):
        yield PlannedJob(index, 0, EpisodeSpec.of(recordings[index % len(recordings)].meta.job))


@click.command()
@count_option(
    "--episodes", 40, "Number of episodes of each variant; an episode of frames takes about 0.5 MB per frame."
)
@count_option("--workers", 8, "Number of simulated workers.", most=64)
@pullers_option()
@click.option(
    "--spot-checks",
    type=click.FloatRange(0.0, 1.0),
    default=0.05,
    metavar="SHARE",
    show_default=True,
    help="Share of bundles that the coordinator validates itself in the variant with spot checks.",
)
@record_option
@json_option
def command(episodes: int, workers: int, pullers: int, spot_checks: float, record: str | None, as_json: bool) -> None:
    """Measure the rate at which a coordinator archives valid bundles.

    Simulated workers deliver copies of two recorded episodes over the network, with central validation and with spot
    checks of bundles that the workers have validated. The datasets are written to the directory for temporary files;
    the environment variable TMPDIR selects another one.
    """
    plan = shrink(narrow(load_plan(SAMPLE_PLAN), ("office",), 2), record=Recording(record) if record else None)
    with progress_bar("delivery", plan.episodes + 2) as tell, temporary_folder() as folder:
        catalog = open_catalog(plan, folder, scene_cache())
        with SimulationContext() as stage:
            samples = make_sample(folder / "sample", plan, catalog, stage, tell)
        report = bench_delivery(
            plan,
            catalog,
            samples,
            folder,
            episodes=episodes,
            workers=workers,
            pullers=pullers,
            shares=(None, spot_checks),
            tell=tell,
        )
    print_result(report, as_json, _show)


def _show(report: DeliveryBench) -> None:
    title = (
        f"{report.episodes} {report.record} episodes of {report.mb_per_episode:.2f} MB, {report.frames} steps, "
        f"{report.workers} simulated workers"
    )
    rows = [
        (
            *("all" if pace.spot_checks is None else f"{pace.spot_checks:g}", pace.validated, pace.pullers),
            *(f"{pace.frames_per_cpu_s:.0f}", f"{pace.episodes_per_cpu_s:.1f}"),
            *(f"{pace.frames_per_s:.0f}", f"{pace.episodes_per_s:.1f}"),
        )
        for pace in report.paces
    ]
    columns = ("share", "validated", "pullers", "frames/CPU s", "episodes/CPU s", "frames/s", "episodes/s")
    print_table(title, columns, rows)


if __name__ == "__main__":
    run(command)
