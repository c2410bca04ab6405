"""Drafts a plan for a newly imported scene. Pure functions; writes no files."""

from __future__ import annotations

from collections import Counter

from coordinator.expansion.catalog import SceneEntry
from coordinator.expansion.nearest import find_nearest
from schemas.config import TaskConfig
from schemas.plan import PAPER_SPLITS, Plan, ScenePlan
from schemas.terms import Split, SuccessMeasure

__all__ = ["draft_plan"]

_EPISODES = 100


def draft_plan(entry: SceneEntry, usd: str, **files: str | bool) -> Plan | None:
    """Returns a feasible plan of a scene; holds out the rarest category if the scene has two or more.

    Args:
        entry: Scene.
        usd: Path of the root layer of the stage.
        files: `rules`, `targets` and `allow_outside` of the scene, if used for the import.

    Returns:
        The plan, or `None` when no target has a valid start pose for the expert.
    """
    counts = Counter(target.category for target in entry.info.targets)
    seen = sorted(counts, key=lambda name: (-counts[name], name))
    held_out = [seen.pop()] if len(seen) > 1 else []
    scene = ScenePlan.model_validate(
        {"name": entry.info.name, "usd": usd, "seen": seen, "held_out": held_out, "episodes": _EPISODES, **files}
    )
    splits = PAPER_SPLITS if held_out else _without_held_out()
    task = TaskConfig(success=SuccessMeasure.SURFACE)
    plan = Plan(name=entry.info.name, scenes=(scene,), splits=dict(splits), task=task)
    return find_nearest(plan, {entry.info.name: entry}).plan


def _without_held_out() -> dict[Split, float]:
    kept = {split: share for split, share in PAPER_SPLITS.items() if split is not Split.TEST_OOD_OBJ}
    return {split: round(share / sum(kept.values()), 4) for split, share in kept.items()}
