"""Defines the built-in plans, and recognises reduced `paper` plans. Reads no file."""

from __future__ import annotations

from types import MappingProxyType

from schemas.config import DemonstrationConfig, InstructionConfig, RobotConfig, SpawnConfig, TaskConfig
from schemas.language.expression import Family
from schemas.language.language_file import LanguageSpec
from schemas.plan import PAPER_SPLITS, Budget, Plan, ScenePlan
from schemas.terms import PAPER_SCENES, ExpertName, Screening, Split, SuccessMeasure, Tier

_BY_SURFACE = TaskConfig(success=SuccessMeasure.SURFACE)

_DEMO = Plan(
    name="demo",
    scenes=tuple(ScenePlan(name=name, episodes=4) for name in PAPER_SCENES),
    tiers={Tier.NEAR: 1.0},
    splits=dict.fromkeys((Split.TRAIN_ID, Split.TEST_ID, Split.TEST_PARAPHRASE_OOD, Split.TEST_OOD_OBJ), 0.25),
    balance="categories",
    task=_BY_SURFACE,
)
"""16 near episodes: four per scene, one of each split except val_id. With frames, it takes minutes on two cores and
less than 1 GB of disk space."""

_PAPER = Plan(
    name="paper",
    scenes=(
        ScenePlan(name="office", episodes=700, screening=Screening.SIGHT),
        ScenePlan(name="hospital", episodes=52),
        ScenePlan(name="full_warehouse", episodes=354),
        ScenePlan(name="warehouse_multiple_shelves", episodes=68),
    ),
    robot=RobotConfig(max_braking_mps2=7.0),
    spawn=SpawnConfig(screening=Screening.NONE, far_floor_m=(5.0, 6.5)),
)
"""1174 episodes with the paper's shares, seed and expert, and a braking limit fitted to the published drives
(docs/design/starts.md#drives-of-paper). Starts are not screened, except in the office: the paper's office is one open
room, but this office has inner walls, so its near and mid starts need sight of the target
(docs/design/starts.md#sight-in-the-office-of-paper)."""

_AMBIGUOUS = {"full_warehouse": ("rack",), "warehouse_multiple_shelves": ("shelf", "rack")}
"""Ambiguous categories by scene: almost every start in the scene shows several objects of such a category
(docs/design/starts.md#ambiguous-categories-of-balanced)."""


def _balanced_scene(name: str, seen: int, held_out: int) -> ScenePlan:
    """Returns a scene with 9 x `seen` episodes of seen categories and `held_out` episodes of held-out categories."""
    numbers = dict.fromkeys((Split.VAL_ID, Split.TEST_ID, Split.TEST_PARAPHRASE_OOD), seen)
    numbers |= {Split.TRAIN_ID: 6 * seen, Split.TEST_OOD_OBJ: held_out}
    episodes = sum(numbers.values())
    shares = {split: numbers[split] / episodes for split in PAPER_SPLITS}
    return ScenePlan(name=name, episodes=episodes, splits=shares, ambiguous=_AMBIGUOUS.get(name, ()))


_BALANCED = Plan(
    name="balanced",
    scenes=(
        _balanced_scene("office", 70, 30),
        _balanced_scene("hospital", 20, 30),
        _balanced_scene("full_warehouse", 15, 30),
        _balanced_scene("warehouse_multiple_shelves", 15, 30),
    ),
    expert=ExpertName.PLANNER,
    balance="categories_overall",
    disjoint_instances=True,
    instructions=InstructionConfig(unique="view"),
    budget=Budget(attempts_per_draw=3),
    task=_BY_SURFACE,
    demonstration=DemonstrationConfig(max_contact_steps=0, target_in_view=True),
)
"""1200 episodes: 135 of each seen category and 30 of each held-out category, planner expert, colours on, disjoint
instances for training and evaluation, instructions that fit one object, no contact and the target in view on arrival.
The numbers of episodes per scene permit equal shares of the categories, and each scene names all its categories
(docs/design/jobs.md#equal-shares-of-categories)."""

_REFERRING = Plan(
    name="referring",
    scenes=(ScenePlan(name="office", episodes=800), ScenePlan(name="hospital", episodes=400)),
    tiers={Tier.NEAR: 0.5, Tier.MID: 0.5},
    splits={Split.TRAIN_ID: 0.6, Split.TEST_ID: 0.2, Split.TEST_PARAPHRASE_OOD: 0.1, Split.TEST_FALSE_PREMISE: 0.1},
    expert=ExpertName.PLANNER,
    balance="categories",
    disjoint_instances=True,
    language=LanguageSpec(
        in_view=1, exchangeable=True, features={"ordinal": 3.0, "ego": 0.5}, largest_shares={Family.ORDINAL: 0.3}
    ),
    budget=Budget(attempts_per_draw=1),
    spawn=SpawnConfig(heading_noise_rad=0.75),
    task=_BY_SURFACE,
    demonstration=DemonstrationConfig(max_contact_steps=0),
)
"""1200 episodes whose starts show several objects of the named category that could be the target. The target is drawn
from these objects, and only the verified instruction, which fits no other object, identifies it."""

BUILTIN_PLANS = MappingProxyType({plan.name: plan for plan in (_DEMO, _PAPER, _BALANCED, _REFERRING)})


def is_paper_plan(plan: Plan) -> bool:
    """Returns whether a plan is `paper`, or differs from it only in scenes, episodes, expert, seed or record."""
    theirs = [scene.model_copy(update={"episodes": part.episodes}) for scene in _PAPER.scenes for part in plan.scenes]
    kept = {name: getattr(_PAPER, name) for name in ("scenes", "expert", "seed", "record")}
    whole = plan.model_copy(update=kept)
    return whole == _PAPER and all(scene in theirs for scene in plan.scenes)
