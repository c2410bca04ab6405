"""Measures how many valid bundles a coordinator archives, for several shares of spot checks.

Each variant starts a coordinator on a new ledger and a process of simulated workers. Simulates no episodes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path

from coordinator.expansion.catalog import Catalog
from coordinator.expansion.draw import PlannedJob, to_job
from coordinator.ledger.archived import count_unchecked
from coordinator.ledger.database.engine import open_reader, open_writer
from coordinator.ledger.opening import ledger_url_of, open_run
from coordinator.settings import CoordinatorSettings
from factory.bench.machine import describe_machine
from factory.bench.results import DeliveryBench, DeliveryCost, DeliveryPace
from factory.bench.service.coordinator_process import CoordinatorReady, serve_archive
from factory.bench.service.delivery_fleet import RecordedBundle, deliver_copies
from factory.bench.service.wire import process, receive, usage
from factory.bench.workload import BenchSample
from schemas.episode_spec import EpisodeSpec
from schemas.plan import Plan

_LEASE_S = 600.0
_WAITING = 512
"""Largest number of bundles that wait for the coordinator, summed over all workers."""
_WAITING_BYTES = 1 << 30
"""Largest total size of the bundles that wait for the coordinator, bytes."""
_READY_BYTES = 1 << 29
"""Threshold of the total size of all bundles, bytes. Below it, all bundles are made before the measurement; otherwise,
each bundle is made when its job is claimed."""


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
