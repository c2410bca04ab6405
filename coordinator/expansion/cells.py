"""Computes the exact quota of every cell of scene x split x tier. Does not read the scenes."""

from __future__ import annotations

from schemas.layouts import Cell, Cells, LayoutPlan, cross_quota
from schemas.plan import Plan, ScenePlan
from schemas.terms import Split

__all__ = ["Cell", "Cells", "cells", "empty_splits"]


def cells(plan: Plan, scene: ScenePlan) -> Cells:
    """Returns the quota of every cell of a scene, of a layout or of all layouts of a family; cells without episodes
    are omitted."""
    if isinstance(scene, LayoutPlan):
        return scene.quota
    return cross_quota(plan.splits_of(scene), plan.tiers_of(scene), scene.episodes)


def empty_splits(plan: Plan) -> tuple[Split, ...]:
    """Returns the requested splits that get no episode, because the plan has too few episodes."""
    wanted = {split for scene in plan.scenes for split, share in plan.splits_of(scene).items() if share > 0}
    filled = {split for scene in plan.scenes for split, _ in cells(plan, scene)}
    return tuple(split for split in Split if split in wanted - filled)
