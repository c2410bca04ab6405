"""Benchmarks whole runs on this machine: coordinator, workers, validation and archive, from start to finished dataset.

Variants of a plan take turns, so a change of the machine's load affects all of them. The datasets are deleted.
"""

from __future__ import annotations

import resource
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from coordinator.expansion.catalog import Catalog
from coordinator.settings import CoordinatorSettings
from factory.bench.results import CollectPace, Spread
from factory.runs.local import LocalRun, run_locally
from schemas.errors import WorldError
from schemas.plan import Plan
from schemas.protocol.status import Progress
from schemas.terms import RendererKind


@dataclass(frozen=True)
class _Run:
    """One timed run."""

    wall_s: float
    cpu_s: float
    """CPU time of this process and of all processes that it started, seconds."""
    progress: Progress


def bench_collect(
    variants: Mapping[str, Plan],
    catalog: Catalog,
    folder: Path,
    workers: int,
    repeats: int,
    renderer: RendererKind,
    tell: Callable[[], None],
) -> dict[str, CollectPace]:
    """Runs every plan `repeats` times, in turns, and returns the pace of each.

    Args:
        variants: plan of each variant by name; `catalog` contains all of their scenes.
        catalog: compiled scenes.
        folder: directory for the temporary datasets.
        workers: number of simulation processes.
        repeats: number of runs of each plan.
        renderer: type of the renderer.
        tell: progress callback, called after every run.

    Raises:
        WorldError: a run does not archive all of its episodes.
    """
    runs: dict[str, list[_Run]] = {name: [] for name in variants}
    for _ in range(repeats):
        for name, plan in variants.items():
            with tempfile.TemporaryDirectory(dir=folder) as root:
                runs[name].append(_time(LocalRun(plan, catalog, root=Path(root), workers=workers, renderer=renderer)))
            tell()
    return {name: _pace(variants[name], runs[name]) for name in variants}


def _time(run: LocalRun) -> _Run:
    wall, cpu = time.perf_counter(), _cpu_s()
    progress = run_locally(run, CoordinatorSettings(), threading.Event(), lambda _: None)
    timed = _Run(time.perf_counter() - wall, _cpu_s() - cpu, progress)
    if progress.missing:
        raise WorldError(f"{progress.missing} of {progress.planned} episodes are missing: run fewer --episodes")
    return timed


def _cpu_s() -> float:
    """Returns the CPU time of this process and of all its descendants that have ended, seconds."""
    usages = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def _pace(plan: Plan, runs: list[_Run]) -> CollectPace:
    return CollectPace(
        record=plan.record,
        expert=plan.expert,
        episodes=plan.episodes,
        attempts=sum(runs[0].progress.attempts.values()),
        episodes_per_hour=Spread.of([3600 * plan.episodes / run.wall_s for run in runs]),
        cpu_s_per_episode=Spread.of([run.cpu_s / plan.episodes for run in runs]),
    )
