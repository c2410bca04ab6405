"""The exact quota of every cell of scene x split x tier. Pure; knows nothing of what the scenes hold."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import TypeVar

from coordinator.plan.apportion import apportion, webster_sequence
from schemas.plan import Plan, ScenePlan
from schemas.terms import Split, Tier

__all__ = ["Cells", "cells"]

Share = TypeVar("Share", Split, Tier)
Cells = dict[tuple[Split, Tier], int]


def cells(plan: Plan, scene: ScenePlan) -> Cells:
    """Returns the quota of every cell of a scene; zero cells are left out."""
    tiers = iter(webster_sequence(_positive(plan.tiers_of(scene)), scene.episodes))
    quota: Counter[tuple[Split, Tier]] = Counter()
    for split, count in apportion(_positive(plan.splits_of(scene)), scene.episodes).items():
        quota.update((split, next(tiers)) for _ in range(count))
    return dict(quota)


def _positive(shares: Mapping[Share, float]) -> dict[Share, float]:
    return {key: share for key, share in shares.items() if share > 0}
