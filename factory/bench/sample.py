"""A small real dataset to read, validate and archive: episodes driven here, tables and all. Times nothing."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path

from coordinator.archive.contract import Archive
from coordinator.archive.directory import DirectoryArchive
from coordinator.expansion.catalog import Catalog
from coordinator.expansion.draw import expand, to_job
from coordinator.tables.write import write_tables
from schemas.dataset import EpisodeSummary, summary_of
from schemas.errors import WorldError
from schemas.job import Job
from schemas.plan import Plan
from workers.sim.attempt import AttemptFailure, run_attempt
from workers.sim.scene_renderer import SceneRenderer

__all__ = ["BenchSample", "make_sample"]


@dataclass(frozen=True)
class BenchSample:
    """One archived episode."""

    job: Job
    path: Path
    """Of the bundle."""


def make_sample(
    root: Path, plan: Plan, catalog: Catalog, stage: SceneRenderer, tell: Callable[[], None]
) -> tuple[BenchSample, ...]:
    """Tries every episode of a plan once and writes those that succeed as a dataset.

    Args:
        root: where to.
        plan: a small one.
        catalog: its scenes.
        stage: to drive on.
        tell: told after every attempt.

    Raises:
        WorldError: nothing succeeded, or the directory cannot be written.
    """
    rows: list[EpisodeSummary] = []
    samples: list[BenchSample] = []
    with DirectoryArchive(root) as archive:
        for planned in expand(plan, catalog):
            job = to_job(plan, catalog, planned, attempt=1)
            entry = catalog[job.scene]
            stage.load(archive.add_scene(entry.path, job.scene, entry.sha256), entry.sha256)
            row = _try(archive, job, stage)
            tell()
            if row is not None:
                rows.append(row)
                samples.append(BenchSample(job, archive.path_of(job.index)))
        if not rows:
            raise WorldError(f"none of {plan.episodes} attempts succeeded, so nothing can be measured")
        scenes = {name: entry.sha256 for name, entry in catalog.items()}
        write_tables(archive, plan, scenes, rows, [], datetime.now(UTC))
    return tuple(samples)


def _try(archive: Archive, job: Job, stage: SceneRenderer) -> EpisodeSummary | None:
    out = BytesIO()
    outcome = run_attempt(job, stage, out, "bench", lambda _step: None)
    if isinstance(outcome, AttemptFailure):
        return None
    data = out.getvalue()
    with archive.stage(job.index) as staged:
        staged.write(data)
        archive.publish(staged, job.index)
    return summary_of(outcome.meta, hashlib.sha256(data).hexdigest(), len(data))
