"""The nearest feasible plan: every cell has a target, changes are minimal, and TOML preserves the plan."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from coordinator.expansion.builtin import BUILTIN_PLANS
from coordinator.expansion.catalog import Catalog
from coordinator.expansion.cells import cells
from coordinator.expansion.draw import expand
from coordinator.expansion.nearest import find_nearest
from coordinator.expansion.plan_file import load_plan, plan_to_toml
from coordinator.expansion.possible import find_impossible
from schemas.config import SpawnConfig
from schemas.plan import Budget, Plan, ScenePlan
from schemas.terms import ExpertName, Split, Tier
from tests.builders.catalog import make_catalog, make_entry, make_target

NEAR_AND_MID = (Tier.NEAR, Tier.MID)


def hospital(seen: Sequence[Tier] = tuple(Tier), held_out: Sequence[Tier] | None = tuple(Tier)) -> Catalog:
    """A hospital whose targets have starts in these tiers; `held_out=None` omits the held-out categories."""
    names = {"chair": seen, "trash_can": seen}
    if held_out is not None:
        names |= {"fire_extinguisher": held_out, "whiteboard": held_out}
    pairs = [(name, number) for name in names for number in range(4)]
    targets = [make_target(name, n, place, tiers=names[name]) for place, (name, n) in enumerate(pairs, 1)]
    return {"hospital": make_entry("hospital", targets)}


def plan_of(episodes: int = 100) -> Plan:
    return Plan(name="x", scenes=(ScenePlan(name="hospital", episodes=episodes),))


def test_the_nearest_plan_of_a_feasible_plan_is_the_plan_itself() -> None:
    found = find_nearest(plan_of(), hospital())
    assert (found.plan, found.changes, found.moved) == (plan_of(), (), 0)


def test_a_scene_without_far_starts_drops_the_far_tier_and_keeps_its_splits() -> None:
    plan, catalog = plan_of(), hospital(NEAR_AND_MID, NEAR_AND_MID)
    assert any("train_id / far (18 episodes)" in line for line in find_impossible(plan, catalog))
    found = find_nearest(plan, catalog)
    assert found.plan is not None
    (scene,) = found.plan.scenes
    assert scene.tiers == pytest.approx({Tier.NEAR: 3 / 7, Tier.MID: 4 / 7})
    assert scene.splits == {}
    assert scene.episodes == 100
    assert found.moved == 30
    assert "far 0 (30 of 100 episodes in other cells)" in found.changes[0]


def test_a_scene_without_held_out_categories_drops_their_split_and_keeps_its_tiers() -> None:
    found = find_nearest(plan_of(), hospital(held_out=None))
    assert found.plan is not None
    (scene,) = found.plan.scenes
    assert scene.tiers == {}
    assert Split.TEST_OOD_OBJ not in scene.splits
    assert sum(scene.splits.values()) == pytest.approx(1)
    assert "held_out without fire_extinguisher, whiteboard" in found.changes[0]


def test_the_nearest_plan_drops_the_tier_or_the_split_whichever_moves_fewer_episodes() -> None:
    found = find_nearest(plan_of(), hospital(held_out=NEAR_AND_MID))
    assert found.plan is not None
    (scene,) = found.plan.scenes
    assert scene.tiers == {}
    assert Split.TEST_OOD_OBJ not in scene.splits
    assert found.moved == 10


def test_a_scene_without_reachable_targets_is_dropped_and_the_others_stay() -> None:
    scenes = (ScenePlan(name="hospital", episodes=20), ScenePlan(name="office", episodes=10))
    plan = Plan(name="x", scenes=scenes)
    found = find_nearest(plan, {**hospital((), ()), "office": make_catalog(plan)["office"]})
    assert found.plan is not None
    assert found.plan.scenes == scenes[1:]
    assert found.changes == ("hospital: removed, 20 episodes; no target of these categories is reachable",)
    assert find_nearest(plan_of(), hospital((), ())).plan is None


def test_a_scene_without_requested_categories_is_dropped_with_that_reason() -> None:
    scenes = (ScenePlan(name="hospital", episodes=20), ScenePlan(name="office", episodes=10))
    plan = Plan(name="x", scenes=scenes)
    other = make_entry("hospital", [make_target("shelf", 1, 1)])
    found = find_nearest(plan, {"hospital": other, "office": make_catalog(plan)["office"]})
    assert found.changes == ("hospital: removed, 20 episodes; it has none of the requested categories",)


@pytest.mark.parametrize("seen", [(Tier.NEAR,), NEAR_AND_MID, (Tier.FAR,)])
@pytest.mark.parametrize("held_out", [None, (), (Tier.MID,), NEAR_AND_MID])
@pytest.mark.parametrize("episodes", [3, 50, 101])
def test_the_nearest_plan_expands_with_exact_quotas(
    seen: tuple[Tier, ...], held_out: tuple[Tier, ...] | None, episodes: int
) -> None:
    catalog = hospital(seen, held_out)
    found = find_nearest(plan_of(episodes), catalog)
    assert found.plan is not None
    assert find_impossible(found.plan, catalog) == []
    jobs = expand(Plan.model_validate(found.plan.model_dump()), catalog)
    assert len(jobs) == episodes == sum(cells(found.plan, found.plan.scenes[0]).values())


def own_plan() -> Plan:
    lab = ScenePlan(
        name="lab",
        usd="/data/lab.usda",
        seen=("chair",),
        episodes=3,
        tiers={Tier.NEAR: 1.0},
        splits={Split.TRAIN_ID: 1.0},
    )
    return Plan(
        name="own",
        seed=7,
        scenes=(ScenePlan(name="office", episodes=5, seed=3), lab),
        expert=ExpertName.PLANNER,
        colors="off",
        disjoint_instances=True,
        budget=Budget(draws=3),
        spawn=SpawnConfig(margin_m=0.07),
    )


@pytest.mark.parametrize("plan", [*BUILTIN_PLANS.values(), own_plan()], ids=lambda plan: plan.name)
def test_a_plan_written_as_toml_is_read_back_unchanged(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(plan_to_toml(plan))
    assert load_plan(str(path)) == plan
    assert load_plan(str(path)).digest == plan.digest


@pytest.mark.parametrize("sign", ["\x7f", "\t", "\x1f", '"', "\\", "ö", "\U0001f916"], ids=ascii)
def test_a_path_with_special_characters_is_read_back_from_toml(sign: str, tmp_path: Path) -> None:
    plan = own_plan()
    named = plan.scenes[1].model_copy(update={"usd": f"/data/lab{sign}1.usda"})
    path = tmp_path / "plan.toml"
    path.write_text(plan_to_toml(plan.model_copy(update={"scenes": (plan.scenes[0], named)})), encoding="utf-8")
    assert load_plan(str(path)).scenes[1].file == named.file
