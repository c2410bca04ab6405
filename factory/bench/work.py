"""What the benchmarks work on: a plan narrowed to some scenes and episodes, and the first attempts at them."""

from __future__ import annotations

from collections.abc import Sequence

from coordinator.expansion.catalog import Catalog
from coordinator.expansion.draw import expand, to_job
from coordinator.expansion.file import shrink
from schemas.errors import UsageError
from schemas.job import Job
from schemas.plan import Plan

__all__ = ["first_attempts", "narrow"]


def narrow(plan: Plan, scenes: Sequence[str], episodes: int) -> Plan:
    """Returns the plan with these scenes only, or all when none is named, and so many episodes in each.

    Raises:
        UsageError: the plan has no scene of that name, or fewer episodes of it.
    """
    names = list(scenes) or [scene.name for scene in plan.scenes]
    parts = tuple(shrink(plan, scenes=(name,), episodes=1).scenes[0] for name in dict.fromkeys(names))
    found = {scene.name: scene.episodes for scene in plan.scenes}
    short = [f"{part.name} {found[part.name]}" for part in parts if found[part.name] < episodes]
    if short:
        raise UsageError(
            f"--episodes {episodes}: plan {plan.name!r} has fewer episodes of {', '.join(short)}; choose another PLAN"
        )
    return plan.model_copy(update={"scenes": tuple(part.model_copy(update={"episodes": episodes}) for part in parts)})


def first_attempts(plan: Plan, catalog: Catalog, scene: str) -> tuple[Job, ...]:
    """Returns the first attempt at every episode of a scene."""
    planned = (job for job in expand(plan, catalog) if job.episode.scene == scene)
    return tuple(to_job(plan, catalog, job, attempt=1) for job in planned)
