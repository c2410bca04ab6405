"""Defines the built-in plans `demo`, `paper` and `balanced`, and recognises reduced `paper` plans. Reads no file."""

from __future__ import annotations

from types import MappingProxyType

from schemas.plan import Plan, ScenePlan
from schemas.terms import BUILTIN_CATEGORIES, ExpertName, Split, Tier

__all__ = ["BUILTIN_PLANS", "is_paper_plan"]

_DEMO = Plan(
    name="demo",
    scenes=tuple(ScenePlan(name=name, episodes=4) for name in BUILTIN_CATEGORIES),
    tiers={Tier.NEAR: 1.0},
    splits=dict.fromkeys((Split.TRAIN_ID, Split.TEST_ID, Split.TEST_PARAPHRASE_OOD, Split.TEST_OOD_OBJ), 0.25),
    balance="categories",
)
"""16 near episodes: four per scene, one of each split except val_id. It takes minutes on two cores and under 1 GB."""

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
"""Equal scenes and categories, planner expert, colours on, disjoint instances for training and evaluation."""

BUILTIN_PLANS = MappingProxyType({plan.name: plan for plan in (_DEMO, _PAPER, _BALANCED)})


def is_paper_plan(plan: Plan) -> bool:
    """Returns whether a plan is `paper`, or a variant with fewer scenes or episodes, other expert, seed or record."""
    theirs = [ScenePlan(name=scene.name, episodes=part.episodes) for scene in _PAPER.scenes for part in plan.scenes]
    kept = {name: getattr(_PAPER, name) for name in ("scenes", "expert", "seed", "record")}
    whole = plan.model_copy(update=kept)
    return whole == _PAPER and all(scene in theirs for scene in plan.scenes)
