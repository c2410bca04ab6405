"""Training and evaluation use different instances where a scene has enough; shared instances are reported."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coordinator.expansion.builtin import BUILTIN_PLANS
from coordinator.expansion.catalog import Catalog
from coordinator.expansion.draw import PlannedJob, expand, redraw
from coordinator.expansion.instances import Side, shared_categories
from coordinator.expansion.plan_file import shrink
from coordinator.expansion.scene_cells import scene_cells
from schemas.plan import Plan, ScenePlan
from schemas.terms import ExpertName, Split, Tier
from tests.builders.catalog import make_catalog, make_entry, make_target

EVALUATION = (Split.VAL_ID, Split.TEST_ID, Split.TEST_PARAPHRASE_OOD)


def office_plan(episodes: int = 200, **changes: object) -> Plan:
    scene = ScenePlan(name="hospital", episodes=episodes)
    return Plan(name="x", scenes=(scene,), disjoint_instances=True, balance="categories").model_copy(update=changes)


def hospital_of(chairs: int, bins: int, tiers: tuple[Tier, ...] = tuple(Tier)) -> Catalog:
    numbers = [("chair", n) for n in range(chairs)] + [("trash_can", n) for n in range(bins)]
    held_out = [("fire_extinguisher", 0), ("whiteboard", 0)]
    targets = [make_target(name, n, place, tiers=tiers) for place, (name, n) in enumerate(numbers, 1)]
    targets += [make_target(name, n, 500 + place) for place, (name, n) in enumerate(held_out)]
    return {"hospital": make_entry("hospital", targets)}


def named(jobs: list[PlannedJob], *splits: Split) -> set[str]:
    return {job.episode.target_id for job in jobs if job.episode.split in splits}


def with_redraws(plan: Plan, catalog: Catalog, draws: int = 8) -> list[PlannedJob]:
    """Returns the first draw of every episode and `draws` redraws, as if every draw but the last had failed."""
    jobs = list(expand(plan, catalog))
    found = list(jobs)
    for _ in range(draws):
        jobs = [redraw(plan, catalog, job) for job in jobs]
        found += jobs
    return found


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(st.integers(2, 12), st.integers(2, 12), st.integers(0, 5))
def test_training_and_evaluation_share_no_instance_even_after_redraws(chairs: int, bins: int, seed: int) -> None:
    plan, catalog = office_plan(60, seed=seed), hospital_of(chairs, bins)
    jobs = with_redraws(plan, catalog, 4)
    assert not named(jobs, Split.TRAIN_ID) & named(jobs, *EVALUATION)
    assert shared_categories(scene_cells(plan, plan.scenes[0], catalog["hospital"]).sides, catalog["hospital"]) == ()


def test_instances_are_shared_without_the_separation_option() -> None:
    plan, catalog = office_plan(disjoint_instances=False), hospital_of(3, 3)
    assert scene_cells(plan, plan.scenes[0], catalog["hospital"]).sides == {}
    jobs = list(expand(plan, catalog))
    assert named(jobs, Split.TRAIN_ID) & named(jobs, *EVALUATION)


def test_training_gets_its_share_of_the_instances_of_each_category() -> None:
    plan, catalog = office_plan(), hospital_of(39, 12)
    sides = scene_cells(plan, plan.scenes[0], catalog["hospital"]).sides
    count = Counter((name.rsplit("_", 1)[0], side) for name, side in sides.items())
    assert count == {
        ("chair", Side.TRAIN): 26,
        ("chair", Side.EVALUATION): 13,
        ("trash_can", Side.TRAIN): 8,
        ("trash_can", Side.EVALUATION): 4,
    }


def test_a_single_instance_is_shared_and_reported() -> None:
    plan, catalog = office_plan(), hospital_of(6, 1)
    sides = scene_cells(plan, plan.scenes[0], catalog["hospital"]).sides
    assert shared_categories(sides, catalog["hospital"]) == ("trash_can",)
    jobs = with_redraws(plan, catalog)
    assert named(jobs, Split.TRAIN_ID) & named(jobs, *EVALUATION) == {"trash_can_000"}


def test_instances_with_starts_in_every_tier_are_divided_between_training_and_evaluation() -> None:
    targets = [make_target("chair", n, n + 1, tiers=[Tier.NEAR]) for n in range(6)]
    targets += [make_target("chair", n, n + 1) for n in (6, 7)]
    entry = make_entry("hospital", targets)
    plan = office_plan(splits={Split.TRAIN_ID: 0.9, Split.VAL_ID: 0.1})
    sides = scene_cells(plan, plan.scenes[0], entry).sides
    assert {sides["chair_006"], sides["chair_007"]} == {Side.TRAIN, Side.EVALUATION}
    for split in plan.splits:
        for tier in Tier:
            assert scene_cells(plan, plan.scenes[0], entry).pool(split, tier)


def test_the_only_target_of_a_tier_is_shared_so_that_no_cell_is_empty() -> None:
    targets = [make_target("chair", n, n + 1, tiers=[Tier.NEAR, Tier.MID]) for n in range(5)]
    targets += [make_target("trash_can", n, n + 9, tiers=[Tier.NEAR, Tier.MID]) for n in range(5)]
    entry = make_entry("hospital", [*targets, make_target("chair", 5, 6)])
    plan = office_plan(splits={Split.TRAIN_ID: 0.6, Split.TEST_ID: 0.4})
    sides = scene_cells(plan, plan.scenes[0], entry).sides
    assert shared_categories(sides, entry) == ("chair",)
    assert scene_cells(plan, plan.scenes[0], entry).pool(Split.TEST_ID, Tier.FAR)
    assert scene_cells(plan, plan.scenes[0], entry).pool(Split.TRAIN_ID, Tier.FAR)


def test_the_division_of_instances_depends_only_on_plan_and_scene_and_omits_instances_without_starts() -> None:
    catalog = hospital_of(9, 9)
    first, second = (scene_cells(office_plan(), office_plan().scenes[0], catalog["hospital"]).sides for _ in range(2))
    assert first == second
    other = office_plan(seed=7)
    assert scene_cells(other, other.scenes[0], catalog["hospital"]).sides != first
    nowhere = hospital_of(9, 9, tiers=())
    planner = office_plan(expert=ExpertName.PLANNER)
    assert scene_cells(planner, planner.scenes[0], nowhere["hospital"]).sides == {}


def test_the_balanced_plan_keeps_the_instances_of_training_and_evaluation_apart() -> None:
    plan = shrink(BUILTIN_PLANS["balanced"], episodes=240)
    catalog = make_catalog(plan)
    jobs = list(expand(plan, catalog))
    for scene in plan.scenes:
        here = [job for job in jobs if job.episode.scene == scene.name]
        assert not named(here, Split.TRAIN_ID) & named(here, *EVALUATION)
