"""Plan expansion: exact quotas, clean splits, even draws, deterministic redraws."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from coordinator.expansion.builtin import BUILTIN_PLANS, is_paper_plan
from coordinator.expansion.cells import cells, empty_splits
from coordinator.expansion.draw import PlannedJob, expand, redraw, to_job
from coordinator.expansion.plan_file import shrink
from coordinator.expansion.possible import find_impossible
from coordinator.expansion.scene_cells import scene_cells
from schemas.config import SpawnConfig, TaskConfig
from schemas.errors import InvalidPlan
from schemas.job import Job
from schemas.plan import Plan, ScenePlan
from schemas.support.apportion import apportion, webster_sequence
from schemas.terms import PAPER_SCENES, ExpertName, Screening, Split, SuccessMeasure, Tier
from tests.builders.catalog import make_catalog, make_entry, make_target

PAPER = BUILTIN_PLANS["paper"]
BY_SURFACE = TaskConfig(success=SuccessMeasure.SURFACE)


@given(st.dictionaries(st.text(max_size=3), st.floats(0.01, 1.0), min_size=1, max_size=6), st.integers(0, 300))
def test_apportionment_has_the_exact_sum_and_counts_of_equal_shares_differ_by_at_most_one(shares, count):
    seats = apportion(shares, count)
    assert sum(seats.values()) == count
    equal = apportion(dict.fromkeys(shares, 1.0), count)
    assert max(equal.values()) - min(equal.values()) <= 1


@given(st.integers(1, 400))
def test_a_longer_webster_sequence_never_reduces_a_count(count):
    shares = {"a": 0.6, "b": 0.3, "c": 0.1}
    assert webster_sequence(shares, count) == webster_sequence(shares, count + 1)[:-1]


@pytest.mark.parametrize("episodes", [None, 1, 7, 52, 240])
def test_cells_hold_exactly_the_quota_of_every_scene_split_and_tier(episodes):
    plan = shrink(PAPER, episodes=episodes)
    jobs = expand(plan, make_catalog(plan))
    assert [job.index for job in jobs] == list(range(1, plan.episodes + 1))
    for scene in plan.scenes:
        found = Counter((job.episode.split, job.episode.tier) for job in jobs if job.episode.scene == scene.name)
        assert found == cells(plan, scene)
        by_split = Counter(job.episode.split for job in jobs if job.episode.scene == scene.name)
        assert by_split == {s: n for s, n in apportion(plan.splits, scene.episodes).items() if n}
        by_tier = Counter(job.episode.tier for job in jobs if job.episode.scene == scene.name)
        assert by_tier == {t: n for t, n in apportion(plan.tiers, scene.episodes).items() if n}


@pytest.mark.parametrize("episodes", [4, 24, 240])
def test_a_requested_split_without_jobs_is_reported_as_empty(episodes):
    plan = shrink(BUILTIN_PLANS["demo"], episodes=episodes)
    drawn = {job.episode.split for job in expand(plan, make_catalog(plan))}
    assert set(empty_splits(plan)) == {split for split, share in plan.splits.items() if share > 0} - drawn
    assert bool(empty_splits(plan)) == (episodes == 4)


def test_the_paper_plan_counts_1174_episodes_as_published():
    assert PAPER.episodes == 1174
    assert {scene.name: scene.episodes for scene in PAPER.scenes} == {
        "office": 700,
        "hospital": 52,
        "full_warehouse": 354,
        "warehouse_multiple_shelves": 68,
    }


def test_the_demo_has_16_episodes_spread_evenly_over_scenes_and_splits():
    demo = BUILTIN_PLANS["demo"]
    assert demo.episodes == 16
    jobs = expand(demo, make_catalog(demo))
    assert Counter((job.episode.scene, job.episode.split) for job in jobs) == Counter(
        (scene, split) for scene in PAPER_SCENES for split, share in demo.splits.items() if share
    )


def test_the_demo_begins_with_the_same_twelve_jobs_as_its_former_version_with_15_episodes():
    demo = BUILTIN_PLANS["demo"]
    scenes = (*demo.scenes[:3], demo.scenes[3].model_copy(update={"episodes": 3}))
    former = demo.model_copy(update={"scenes": scenes})
    catalog = make_catalog(demo)
    assert expand(former, catalog)[:12] == expand(demo, catalog)[:12]


def test_held_out_categories_appear_only_in_test_ood_obj():
    plan = shrink(PAPER, episodes=300)
    categories = {scene.name: scene.categories for scene in plan.scenes}
    for job in expand(plan, make_catalog(plan)):
        held_out = job.episode.category in categories[job.episode.scene].held_out
        assert held_out == (job.episode.split is Split.TEST_OOD_OBJ)


def test_paraphrased_templates_appear_only_in_test_paraphrase_ood():
    plan = shrink(PAPER, episodes=300)
    for job in expand(plan, make_catalog(plan)):
        assert job.episode.template_id.startswith("ood_") == (job.episode.split is Split.TEST_PARAPHRASE_OOD)


def test_colour_templates_are_omitted_when_colours_are_off():
    plan = shrink(PAPER, episodes=300).model_copy(update={"colors": "off"})
    episodes = [job.episode for job in expand(plan, make_catalog(plan))]
    assert all(episode.colour == "unknown" for episode in episodes)
    drawn = {episode.template_id for episode in episodes}
    assert drawn.isdisjoint({"train_06", "train_07", "train_08", "train_16", "ood_04"})
    assert sum(name.startswith("train") for name in drawn) == 14


def test_plans_balanced_by_scene_draw_categories_as_evenly_as_whole_numbers_allow():
    plan = shrink(BUILTIN_PLANS["demo"], episodes=240)
    episodes = [job.episode for job in expand(plan, make_catalog(plan))]
    counts = Counter(e.category for e in episodes if e.scene == "office" and e.split is not Split.TEST_OOD_OBJ)
    assert max(counts.values()) - min(counts.values()) <= 1


def test_a_redraw_keeps_the_cell_and_replaces_the_target():
    plan = shrink(PAPER, episodes=40)
    catalog = make_catalog(plan)
    for job in expand(plan, catalog):
        for _ in range(12):
            following = redraw(plan, catalog, job)
            assert _cell(following) == _cell(job)
            assert following.draw == job.draw + 1
            assert following.episode.target_id != job.episode.target_id
            job = following


def test_redraws_depend_on_plan_index_and_draw_only():
    plan = shrink(PAPER, episodes=40)
    catalog = make_catalog(plan)
    jobs = expand(plan, catalog)
    forward = [redraw(plan, catalog, job) for job in jobs]
    backward = [redraw(plan, catalog, job) for job in reversed(jobs)]
    assert forward == backward[::-1]


def test_equal_plans_give_equal_jobs_and_another_seed_gives_different_jobs():
    plan = shrink(PAPER, episodes=60)
    catalog = make_catalog(plan)
    assert expand(plan, catalog) == expand(plan, catalog)
    assert expand(plan, catalog) != expand(shrink(plan, seed=7), catalog)


def test_every_infeasible_cell_is_named_before_the_run():
    plan = Plan(name="x", scenes=(ScenePlan(name="hospital", episodes=50),))
    targets = [make_target("chair", 1, 1, tiers=[Tier.NEAR]), make_target("whiteboard", 1, 2)]
    with pytest.raises(InvalidPlan) as caught:
        expand(plan, {"hospital": make_entry("hospital", targets)})
    text = str(caught.value)
    assert "no reachable 'trash_can'" in text
    assert "no reachable 'fire_extinguisher'" in text
    assert "train_id / mid" in text
    assert "train_id / near" not in text


def test_absent_categories_are_reported_on_one_line_and_not_for_each_cell():
    scene = ScenePlan(name="lab", usd="lab.usda", seen=("chair", "table"), held_out=("plant",), episodes=50)
    plan = Plan(name="x", scenes=(scene,))
    (line,) = find_impossible(plan, {"lab": make_entry("lab", [make_target("shelf", 1, 1), make_target("bin", 1, 2)])})
    assert (
        "lab: no reachable 'chair', 'table' (seen), no reachable 'plant' (held_out); reachable in the scene: bin"
        in line
    )
    assert line.endswith("or change the scene, its rules or its list of targets")


def test_an_existing_category_without_targets_is_reported_as_out_of_reach():
    plan = Plan(name="x", scenes=(ScenePlan(name="hospital", episodes=5),), splits={Split.TRAIN_ID: 1.0})
    entry = make_entry("hospital", [make_target("chair", 1, 1), make_target("trash_can", 1, 2)])
    entry = replace(entry, known=entry.info.model_copy(update={"targets": entry.info.targets[:1]}))
    assert "present but not reachable: trash_can" in find_impossible(plan, {"hospital": entry})[0]


def test_an_unused_held_out_category_may_be_absent():
    plan = Plan(name="x", scenes=(ScenePlan(name="hospital", episodes=5),), splits={Split.TRAIN_ID: 1.0})
    entry = make_entry("hospital", [make_target("chair", 1, 1), make_target("trash_can", 1, 2)])
    assert find_impossible(plan, {"hospital": entry}) == []


def test_the_planner_may_start_at_poses_excluded_for_straight_experts():
    plan = Plan(name="x", scenes=(ScenePlan(name="hospital", episodes=5),), splits={Split.TRAIN_ID: 1.0})
    target = make_target("chair", 1, 1).model_copy(update={"straight_tiers": ()})
    entry = make_entry("hospital", [target])
    planner = plan.model_copy(update={"expert": ExpertName.PLANNER})
    pools = [scene_cells(each, plan.scenes[0], entry).pool(Split.TRAIN_ID, Tier.FAR) for each in (plan, planner)]
    assert pools == [(), (target,)]


def test_blind_straight_experts_may_start_at_poses_excluded_for_other_straight_experts() -> None:
    target = make_target("chair", 1, 1).model_copy(update={"straight_tiers": ()})
    entry = make_entry("hospital", [target])
    pools = {}
    for screening in Screening:
        plan = Plan(name="x", scenes=(ScenePlan(name="hospital", episodes=5),), spawn=SpawnConfig(screening=screening))
        pools[screening] = scene_cells(plan, plan.scenes[0], entry).pool(Split.TRAIN_ID, Tier.NEAR)
    blind = {Screening.NONE: (target,), Screening.SIGHT: (target,)}
    assert pools == {**blind, Screening.FREE_LINE: (), Screening.FORESEEN: ()}


def test_jobs_and_plans_record_the_screening() -> None:
    catalog = make_catalog(PAPER)
    assert PAPER.model_dump(mode="json")["spawn"]["screening"] == "none"
    jobs = [to_job(PAPER, catalog, planned, 1) for planned in expand(PAPER, catalog)]
    found = {job.scene: Job.model_validate_json(job.model_dump_json()).spawn.screening for job in jobs}
    assert found == {scene.name: scene.screening or Screening.NONE for scene in PAPER.scenes}
    assert found["office"] is Screening.SIGHT


def test_the_screening_of_a_scene_replaces_that_of_the_plan() -> None:
    target = make_target("chair", 1, 1).model_copy(update={"straight_tiers": ()})
    catalog = {name: make_entry(name, [target]) for name in ("hospital", "office")}
    parts = [{"name": name, "episodes": 2, "seen": ["chair"], "held_out": ["plant"]} for name in catalog]
    parts[1]["screening"] = "none"
    plan = Plan.model_validate({"name": "x", "scenes": parts, "splits": {Split.TRAIN_ID: 1.0}})
    pools = [scene_cells(plan, part, catalog[part.name]).pool(Split.TRAIN_ID, Tier.NEAR) for part in plan.scenes]
    assert pools == [(), (target,)]


@pytest.mark.parametrize("screening", ["none", "foreseen"])
def test_the_paper_plan_with_another_screening_of_a_scene_does_not_count_as_the_paper_plan(screening: str) -> None:
    assert is_paper_plan(shrink(PAPER, scenes=("office", "hospital"), episodes=10))
    office = PAPER.scenes[0].model_copy(update={"screening": Screening(screening)})
    assert not is_paper_plan(PAPER.model_copy(update={"scenes": (office, *PAPER.scenes[1:])}))


def test_the_default_screening_is_omitted_from_json_so_that_old_digests_stay_valid() -> None:
    assert not {"screening", "far_floor_m"} & SpawnConfig().model_dump().keys()
    assert SpawnConfig.model_validate_json(SpawnConfig().model_dump_json()).screening is Screening.FORESEEN
    assert "screening" not in ScenePlan(name="office", episodes=1).model_dump()


def test_the_error_of_the_surface_measure_names_scenes_without_footprints_and_both_remedies():
    plan = Plan(name="old", scenes=(ScenePlan(name="office", episodes=4),), task=BY_SURFACE)
    bare = [make_target("chair", 1, 1).model_copy(update={"footprint_m": (), "surface_straight_tiers": ()})]
    (line,) = find_impossible(plan, {"office": make_entry("office", bare)})
    assert line.startswith("scenes[0] office: its package is of an older version and has no footprints")
    assert "factory scene build" in line
    assert 'task.success = "centroid"' in line


def test_a_target_whose_centroid_is_out_of_reach_is_drawn_only_with_the_surface_measure():
    large = make_target("table", 1, 2).model_copy(update={"straight_tiers": (), "connected_tiers": ()})
    entry = make_entry("office", [make_target("chair", 1, 1), large])
    scene = ScenePlan(name="office", episodes=8, seen=("chair", "table"))
    by_surface = Plan(name="large", scenes=(scene,), splits={Split.TRAIN_ID: 1.0}, task=BY_SURFACE)
    assert {job.episode.category for job in expand(by_surface, {"office": entry})} == {"chair", "table"}
    by_centroid = by_surface.model_copy(update={"task": TaskConfig()})
    assert "no reachable 'table' (seen)" in find_impossible(by_centroid, {"office": entry})[0]


def test_the_random_generator_of_an_attempt_depends_on_seed_index_and_attempt():
    plan = shrink(PAPER, episodes=4)
    catalog = make_catalog(plan)
    first, second = expand(plan, catalog)[:2]
    draws = {to_job(plan, catalog, job, attempt).rng().random() for job in (first, second) for attempt in (1, 2)}
    assert len(draws) == 4
    assert to_job(plan, catalog, first, 1).rng().random() == to_job(plan, catalog, first, 1).rng().random()


def _cell(job: PlannedJob) -> tuple[int, str, Split, Tier]:
    return job.index, job.episode.scene, job.episode.split, job.episode.tier


def test_jobs_with_equal_specs_share_one_object_so_that_large_plans_stay_small():
    plan = shrink(PAPER, episodes=300)
    episodes = [job.episode for job in expand(plan, make_catalog(plan))]
    assert len({id(episode) for episode in episodes}) == len(set(episodes)) < len(episodes)
