"""The smallest plan with a built-in scene."""

from __future__ import annotations

from schemas.plan import Plan, ScenePlan
from schemas.terms import Split, Tier
from tests.builders.bundle import short_task


def small_plan(episodes: int = 3) -> Plan:
    """Returns a plan of near training episodes in the office; the smallest bundles are valid results of its jobs."""
    return Plan(
        name="test",
        scenes=(ScenePlan(name="office", episodes=episodes),),
        tiers={Tier.NEAR: 1.0},
        splits={Split.TRAIN_ID: 1.0},
        task=short_task(),
    )
