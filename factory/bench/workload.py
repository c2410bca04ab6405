"""Workload of the benchmarks: a plan with fewer scenes and episodes, and a small real dataset. Measures nothing.

Imports PyBullet only to simulate, because rendering and reading are measured without it.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from coordinator.archive.contract import Archive
from coordinator.archive.directory import DirectoryArchive
from coordinator.expansion.catalog import Catalog
from coordinator.expansion.draw import expand, to_job
from coordinator.expansion.plan_file import shrink
from coordinator.tables.write import write_tables
from schemas.dataset.rows import EpisodeSummary, file_name_of, summary_of
from schemas.errors import UsageError, WorldError
from schemas.job import Job
from schemas.plan import Plan

if TYPE_CHECKING:
    from workers.sim.context import SimulationContext

SAMPLE_PLAN = "demo"
"""Plan of the benchmarks that need a few episodes of each scene."""


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Yields a folder that is deleted at the end."""
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        yield Path(folder)


def narrow(plan: Plan, scenes: Sequence[str], episodes: int) -> Plan:
    """Returns the plan with `episodes` episodes in each of these scenes, or in every scene if `scenes` is empty.

    Raises:
        UsageError: A scene is not in the plan, or the plan has fewer than `episodes` episodes in a scene.
    """
    names = list(scenes) or [scene.name for scene in plan.scenes]
    parts = tuple(shrink(plan, scenes=(name,), episodes=1).scenes[0] for name in dict.fromkeys(names))
    numbers = {scene.name: scene.episodes for scene in plan.scenes}
    short = [f"{numbers[part.name]} of {part.name}" for part in parts if numbers[part.name] < episodes]
    if short:
        raise UsageError(
            f"--episodes {episodes}: plan {plan.name!r} has fewer episodes ({', '.join(short)}); choose another PLAN"
        )
    return plan.model_copy(update={"scenes": tuple(part.model_copy(update={"episodes": episodes}) for part in parts)})


def first_attempts(plan: Plan, catalog: Catalog, scene: str) -> tuple[Job, ...]:
    """Returns the first attempt at every episode of a scene."""
    planned = (job for job in expand(plan, catalog) if job.episode.scene == scene)
    return tuple(to_job(plan, catalog, job, attempt=1) for job in planned)


@dataclass(frozen=True)
class BenchSample:
    """Archived episode of the sample dataset."""

    job: Job
    path: Path
    """Path of the bundle."""


def make_sample(
    root: Path, plan: Plan, catalog: Catalog, stage: SimulationContext, tell: Callable[[], None]
) -> tuple[BenchSample, ...]:
    """Runs one attempt at every episode of a plan and writes the successful ones as a dataset.

    Args:
        root: Directory of the dataset.
        plan: Plan with few episodes.
        catalog: Scenes of the plan.
        stage: Scene renderer for the attempts.
        tell: Progress callback, called after every attempt.

    Raises:
        WorldError: No attempt succeeded, or the directory cannot be written.
    """
    rows: list[EpisodeSummary] = []
    samples: list[BenchSample] = []
    with DirectoryArchive(root) as archive:
        for planned in expand(plan, catalog):
            job = to_job(plan, catalog, planned, attempt=1)
            entry = catalog[job.scene]
            archive.add_scene(entry.path, job.scene, entry.sha256, entry.textures)
            stage.load(entry.path, entry.sha256)
            row = _try(archive, job, stage)
            tell()
            if row is not None:
                rows.append(row)
                samples.append(BenchSample(job, root / file_name_of(job.episode_id)))
        if not rows:
            raise WorldError(f"none of {plan.episodes} attempts succeeded, so nothing can be measured")
        scenes = {name: entry.sha256 for name, entry in catalog.items()}
        write_tables(archive, plan, scenes=scenes, episodes=rows, failures=[], now=datetime.now(UTC))
    return tuple(samples)


def _try(archive: Archive, job: Job, stage: SimulationContext) -> EpisodeSummary | None:
    from workers.sim.attempt import AttemptFailure, run_attempt

    out = BytesIO()
    outcome = run_attempt(job, stage, out=out, sid="bench", on_step=lambda _step: None)
    if isinstance(outcome, AttemptFailure):
        return None
    data = out.getvalue()
    with archive.stage(job.index) as staged:
        staged.write(data)
        archive.publish(staged, job.index)
    return summary_of(outcome.meta, hashlib.sha256(data).hexdigest(), len(data))
