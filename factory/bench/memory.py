"""Whether a simulation's memory stays flat: many short episodes in all scenes by turns, watched one by one.

Most are cut short after a few frames, for a leak shows at starts and ends; some are driven to their end.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import median
from tempfile import TemporaryFile

from coordinator.plan.catalog import Catalog
from factory.bench.machine import describe_machine, forget_peak, measure_memory, resident_mib
from factory.bench.model import MemoryBench
from schemas.job import Job
from workers.attempt import Success, run_attempt
from workers.stage import Stage

__all__ = ["bench_memory"]

_WHOLE_EVERY = 41
"""One in so many episodes is driven to its end, after one of every scene; a prime, so that all scenes get a turn."""
_STEPS = 5
"""Of all others."""
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
        is_whole = number < len(catalog) or number % _WHOLE_EVERY == 0
        job = jobs[number % len(jobs)] if is_whole else _short(jobs[number % len(jobs)])
        entry = catalog[job.scene]
        stage.load(entry.path, entry.sha256)
        with TemporaryFile() as file:
            outcome = run_attempt(job, stage, file, "bench", lambda _step: None)
        if isinstance(outcome, Success):
            done, frames = done + 1, frames + outcome.meta.rollout.num_steps
        else:
            frames += outcome.steps
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
    return job.model_copy(update={"task": job.task.model_copy(update={"max_steps": _STEPS})})
