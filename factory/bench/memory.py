"""Whether a simulation's memory stays flat: many short episodes in all scenes by turns, watched one by one.

The robot is told that it has arrived, so that an episode takes a few frames and still does all that any episode does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import median
from tempfile import TemporaryFile

from coordinator.catalog import Catalog
from factory.bench.machine import describe_machine, forget_peak, measure_memory, resident_mib
from factory.bench.model import MemoryBench
from schemas.job import Job
from workers.attempt import Success, run_attempt
from workers.stage import Stage

__all__ = ["bench_memory"]

_ANYWHERE_M = 100.0
"""A success radius that holds every start."""
_TENTH = 10


def bench_memory(
    jobs: Sequence[Job], catalog: Catalog, stage: Stage, episodes: int, tell: Callable[[], None]
) -> MemoryBench:
    """Runs short episodes of the jobs in turn and returns what the process held along the way.

    Args:
        jobs: of all scenes, in the order in which they take turns.
        catalog: their scenes.
        stage: to drive on.
        episodes: how many, at least 20.
        tell: told after every episode.
    """
    forget_peak()
    machine, start_mib = describe_machine(), resident_mib()
    held, frames, done = [], 0, 0
    for number in range(episodes):
        job = _short(jobs[number % len(jobs)])
        entry = catalog[job.scene]
        stage.load(entry.path, entry.sha256)
        with TemporaryFile() as file:
            outcome = run_attempt(job, stage, file, "bench", lambda _step: None)
        if isinstance(outcome, Success):
            done, frames = done + 1, frames + outcome.meta.rollout.num_steps
        held.append(resident_mib())
        tell()
    tenth = episodes // _TENTH
    return MemoryBench(
        machine=machine,
        renderer=stage.renderer.description,
        scenes=tuple(catalog),
        episodes=episodes,
        succeeded=done,
        frames=frames,
        settled_mib=median(held[tenth : 2 * tenth]),
        last_mib=median(held[-tenth:]),
        memory=measure_memory(start_mib),
    )


def _short(job: Job) -> Job:
    return job.model_copy(update={"task": job.task.model_copy(update={"success_radius_m": _ANYWHERE_M})})
