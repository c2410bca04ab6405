"""Runs the coordinator under test in a separate process, to measure its memory and CPU time alone. Runs no workers."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.connection import Connection
from pathlib import Path

import structlog

from coordinator.expansion.catalog import Catalog
from coordinator.options import CoordinatorOptions
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from coordinator.validation.messages import Scope, ValidationTask, check_each
from coordinator.validation.validator import Validator
from factory.bench.machine import cpu_s_of_children, measure_memory, resident_mib
from factory.bench.results import Memory
from factory.bench.workload import BenchSample
from factory.support.logs import configure_logs
from schemas.base import Model
from schemas.dataset.rows import EpisodeSummary, summary_of
from schemas.episode import EpisodeMeta
from schemas.errors import InvalidBundle
from schemas.job import Job
from schemas.plan import Plan
from schemas.scene import Target

_LEASE_S = 600.0
"""Lease duration, seconds; long, so no lease expires on a busy machine."""
_LOOPBACK = ("tcp/127.0.0.1:0",)


class CoordinatorReady(Model):
    """Message with which a process reports that its coordinator accepts requests."""

    endpoints: tuple[str, ...]
    seconds: float
    """Time from the start of the coordinator until it accepts requests, seconds; includes the checks of ledger and
    archive."""


class CoordinatorUsage(Model):
    """Memory and CPU time of the coordinator."""

    memory: Memory
    cpu_s: float
    """CPU time of all threads of the coordinator process and of its validating processes since their start, seconds."""


class _AcceptAll:
    """Validator that accepts every bundle, so the benchmark measures the transfer only."""

    def __init__(self, meta: EpisodeMeta, sha256: str, size: int) -> None:
        self._meta, self._sha256, self._size = meta, sha256, size

    def check(
        self,
        path: Path,  # noqa: ARG002
        job: Job,
        candidates: tuple[Target, ...] = (),  # noqa: ARG002
        scope: Scope = Scope.ALL,  # noqa: ARG002
    ) -> EpisodeSummary:
        job = self._meta.job.model_copy(update={"index": job.index})
        meta = self._meta.model_copy(update={"job": job, "episode_id": job.episode_id})
        return summary_of(meta, self._sha256, self._size)

    def check_all(self, bundles: Sequence[tuple[Path, ValidationTask]]) -> list[EpisodeSummary | InvalidBundle]:
        return check_each(self.check, bundles)

    def close(self) -> None:
        pass


def serve_coordinator(
    pipe: Connection, root: Path, plan: Plan, catalog: Catalog, meta: EpisodeMeta, sha256: str, size: int
) -> None:
    """Opens a coordinator, sends its endpoints, and replies to every message with its usage until the pipe closes.

    Args:
        pipe: Pipe to the benchmark; the first message is `CoordinatorReady`, all others are `CoordinatorUsage`.
        root: Directory of the dataset; its ledger may already contain jobs.
        plan: Plan of the ledger.
        catalog: Scenes of the plan.
        meta: Episode metadata, used for every bundle.
        sha256: SHA-256 of every bundle.
        size: Size of every bundle, bytes.
    """
    settings = CoordinatorSettings(lease_ttl_s=_LEASE_S, reserve_bytes=0)
    checker = _AcceptAll(meta, sha256, size)
    _serve(pipe, root, plan, catalog, CoordinatorOptions(listen=_LOOPBACK, settings=settings, checker=checker))


def serve_archive(
    pipe: Connection, root: Path, plan: Plan, catalog: Catalog, settings: CoordinatorSettings, sample: BenchSample
) -> None:
    """Opens a coordinator, starts its validating processes, and replies to messages as `serve_coordinator` does.

    Args:
        pipe: Pipe to the benchmark.
        root: Directory of the dataset with its ledger.
        plan: Plan of the ledger.
        catalog: Scenes of the plan.
        settings: Settings of the coordinator.
        sample: Bundle that each validating process checks once, so the processes run before the coordinator opens.
    """
    packages = {entry.sha256: entry.path for entry in catalog.values()}
    with Validator(settings.pullers, packages=packages) as checker, ThreadPoolExecutor(settings.pullers) as pool:
        list(pool.map(lambda _: checker.check(sample.path, sample.job), range(settings.pullers)))
        _serve(pipe, root, plan, catalog, CoordinatorOptions(listen=_LOOPBACK, settings=settings, checker=checker))


def _serve(pipe: Connection, root: Path, plan: Plan, catalog: Catalog, options: CoordinatorOptions) -> None:
    configure_logs(verbose=False)
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(40))
    started = time.perf_counter()
    with Coordinator(root, plan, catalog, options) as hub:
        pipe.send(CoordinatorReady(endpoints=hub.endpoints, seconds=time.perf_counter() - started))
        start_mib = resident_mib()
        try:
            while True:
                pipe.recv()
                pipe.send(
                    CoordinatorUsage(memory=measure_memory(start_mib), cpu_s=time.process_time() + cpu_s_of_children())
                )
        except EOFError:
            return
