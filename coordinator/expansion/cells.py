"""Computes the exact quota of every cell of scene x split x tier. Does not read the scenes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import TypeVar

from coordinator.expansion.apportion import apportion, webster_sequence
from schemas.plan import Plan, ScenePlan
from schemas.terms import Split, Tier

Share = TypeVar("Share", Split, Tier)
Cell = tuple[Split, Tier]
Cells = dict[Cell, int]


def cells(plan: Plan, scene: ScenePlan) -> Cells:
    """Returns the quota of every cell of a scene; cells without episodes are omitted."""
    tiers = iter(webster_sequence(_positive(plan.tiers_of(scene)), scene.episodes))
    quota: Counter[tuple[Split, Tier]] = Counter()
    for split, count in apportion(_positive(plan.splits_of(scene)), scene.episodes).items():
        quota.update((split, next(tiers)) for _ in range(count))
    return dict(quota)


def empty_splits(plan: Plan) -> tuple[Split, ...]:
    """Returns the requested splits that get no episode, because the plan has too few episodes."""
    asked = {split for scene in plan.scenes for split in _positive(plan.splits_of(scene))}
    filled = {split for scene in plan.scenes for split, _ in cells(plan, scene)}
    return tuple(split for split in Split if split in asked - filled)


def _positive(shares: Mapping[Share, float]) -> dict[Share, float]:
    return {key: share for key, share in shares.items() if share > 0}
