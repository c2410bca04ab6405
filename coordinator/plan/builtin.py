"""The plans that ship with the product: `demo`, `paper`, `balanced`. Data only."""

from __future__ import annotations

from types import MappingProxyType

from schemas.plan import Plan, ScenePlan
from schemas.terms import BUILTIN_CATEGORIES, ExpertName, Split, Tier

__all__ = ["BUILTIN_PLANS"]

_DEMO = Plan(
    name="demo",
    scenes=tuple(ScenePlan(name=name, episodes=4) for name in BUILTIN_CATEGORIES),
    tiers={Tier.NEAR: 1.0},
    splits=dict.fromkeys((Split.TRAIN_ID, Split.TEST_ID, Split.TEST_PARAPHRASE_OOD, Split.TEST_OOD_OBJ), 0.25),
    balance="categories",
)
"""16 near episodes, four of every scene, one of each split but val_id: minutes on two cores, under 1 GB."""

_PAPER = Plan(
    name="paper",
    scenes=(
        ScenePlan(name="office", episodes=700),
        ScenePlan(name="hospital", episodes=52),
        ScenePlan(name="full_warehouse", episodes=354),
        ScenePlan(name="warehouse_multiple_shelves", episodes=68),
    ),
)
"""1174 episodes with the paper's shares, seed and expert."""

_BALANCED = Plan(
    name="balanced",
    scenes=tuple(ScenePlan(name=name, episodes=300) for name in BUILTIN_CATEGORIES),
    expert=ExpertName.PLANNER,
    balance="categories",
    disjoint_instances=True,
)
"""Equal scenes, equal categories, the planner expert, colours on, instances of training and evaluation kept apart."""

BUILTIN_PLANS = MappingProxyType({plan.name: plan for plan in (_DEMO, _PAPER, _BALANCED)})
