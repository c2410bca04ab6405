"""Computes the exact quota of every cell of scene x split x tier. Does not read the scenes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Literal

from schemas.layouts import Cell, Cells, LayoutPlan, cross_quota
from schemas.plan import Plan, ScenePlan
from schemas.terms import Split, Tier

__all__ = ["Cell", "Cells", "cells", "empty_splits", "marginal", "planned_cells"]


def cells(plan: Plan, scene: ScenePlan) -> Cells:
    """Returns the quota of every cell of a scene, of a layout or of all layouts of a family; cells without episodes
    are omitted."""
    if isinstance(scene, LayoutPlan):
        return scene.quota
    return cross_quota(plan.splits_of(scene), plan.tiers_of(scene), scene.episodes)


def planned_cells(plans: Iterable[Plan]) -> Counter[tuple[str, Split, Tier]]:
    """Returns the number of planned episodes of each cell of scene x split x tier over several plans."""
    planned: Counter[tuple[str, Split, Tier]] = Counter()
    for plan in plans:
        for part in plan.parts:
            for (split, tier), count in cells(plan, part).items():
                planned[part.name, split, tier] += count
    return planned


def marginal(quota: Cells, axis: Literal[0, 1]) -> Counter[Split | Tier]:
    """Returns the number of episodes of each split (axis 0) or each tier (axis 1)."""
    total: Counter[Split | Tier] = Counter()
    for cell, count in quota.items():
        total[cell[axis]] += count
    return total


def empty_splits(plan: Plan) -> tuple[Split, ...]:
    """Returns the requested splits that get no episode, because the plan has too few episodes."""
    wanted = {split for scene in plan.scenes for split, share in plan.splits_of(scene).items() if share > 0}
    filled = {split for scene in plan.scenes for split, _ in cells(plan, scene)}
    return tuple(split for split in Split if split in wanted - filled)
