"""Defines the built-in plans `demo`, `paper` and `balanced`, and recognises reduced `paper` plans. Reads no file."""

from __future__ import annotations

from types import MappingProxyType

from schemas.config import InstructionConfig
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

_BALANCED_EPISODES = {
    "office": (70, 30),
    "hospital": (20, 30),
    "full_warehouse": (15, 30),
    "warehouse_multiple_shelves": (15, 30),
}
"""By scene: episodes of val_id, test_id and test_paraphrase_ood each, a sixth of train_id; and of test_ood_obj."""


def _balanced_scene(name: str, seen: int, held_out: int) -> ScenePlan:
    numbers = {
        Split.TRAIN_ID: 6 * seen,
        Split.VAL_ID: seen,
        Split.TEST_ID: seen,
        Split.TEST_PARAPHRASE_OOD: seen,
        Split.TEST_OOD_OBJ: held_out,
    }
    episodes = sum(numbers.values())
    shares = {split: number / episodes for split, number in numbers.items()}
    ambiguous = tuple(category for category in BUILTIN_CATEGORIES[name].seen if category == "rack")
    return ScenePlan(name=name, episodes=episodes, splits=shares, ambiguous=ambiguous)


_BALANCED = Plan(
    name="balanced",
    scenes=tuple(_balanced_scene(name, *numbers) for name, numbers in _BALANCED_EPISODES.items()),
    expert=ExpertName.PLANNER,
    balance="categories_overall",
    disjoint_instances=True,
    instructions=InstructionConfig(unique="view"),
)
"""1200 episodes: 135 of each seen and 30 of each held-out category, planner expert, colours on, disjoint instances for
training and evaluation, instructions that fit one object. The numbers of the scenes are the evenest ones with which
the office still names all its categories (docs/decisions/0136-*.md)."""

BUILTIN_PLANS = MappingProxyType({plan.name: plan for plan in (_DEMO, _PAPER, _BALANCED)})


def is_paper_plan(plan: Plan) -> bool:
    """Returns whether a plan is `paper`, or a variant with fewer scenes or episodes, other expert, seed or record."""
    theirs = [ScenePlan(name=scene.name, episodes=part.episodes) for scene in _PAPER.scenes for part in plan.scenes]
    kept = {name: getattr(_PAPER, name) for name in ("scenes", "expert", "seed", "record")}
    whole = plan.model_copy(update=kept)
    return whole == _PAPER and all(scene in theirs for scene in plan.scenes)
