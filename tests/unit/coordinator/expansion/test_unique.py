"""Instructions that fit only one object: selected targets, conditions of the job, and refused requests."""

from __future__ import annotations

import math
import tomllib

import pytest

from coordinator.expansion.catalog import read_entry
from coordinator.expansion.draw import expand, redraw, to_job
from coordinator.expansion.nearest import find_nearest
from coordinator.expansion.plan_file import parse_plan, plan_to_toml
from coordinator.expansion.possible import find_impossible
from coordinator.expansion.summary import offer_rows, summarise
from schemas.instruction.referents import referents_of
from schemas.instruction.start_view import StartView
from schemas.instruction.templates import needs_colour
from schemas.job import Job
from schemas.plan import Plan, ScenePlan
from schemas.scene import encode_scene
from schemas.terms import Split, Tier
from tests.builders.catalog import make_catalog, make_entry, make_target
from tests.builders.scene import Box, build_scene, room_walls

TRAIN = {Split.TRAIN_ID: 1.0}
ENTRY = make_entry(
    "office",
    [
        make_target("chair", 1, 1, colour="red"),
        make_target("chair", 2, 2, colour="black"),
        make_target("chair", 3, 3, colour="black"),
        make_target("plant", 1, 4, colour="green"),
        make_target("monitor", 1, 5, colour="unknown"),
        make_target("monitor", 2, 6, colour="unknown"),
    ],
)


def _plan(unique: str, seen: tuple[str, ...] = ("chair", "plant"), episodes: int = 120, **scene: object) -> Plan:
    part = {"name": "office", "episodes": episodes, "seen": seen, **scene}
    return Plan.model_validate(
        {"name": "x", "scenes": [part], "splits": TRAIN, "instructions": {"unique": unique}, "balance": "categories"}
    )


def _jobs(plan: Plan) -> list[Job]:
    catalog = {"office": ENTRY}
    return [to_job(plan, catalog, planned, 1) for planned in expand(plan, catalog)]


def test_scene_unique_plans_name_only_objects_that_category_and_colour_identify():
    plan = _plan("scene")
    jobs = _jobs(plan)
    assert {job.target_id for job in jobs} == {"chair_001", "plant_001"}
    assert all(referents_of(job, ENTRY.info) == {ENTRY.info.target(job.target_id).instance_id} for job in jobs)
    assert all(" red chair" in job.instruction for job in jobs if job.category == "chair")
    assert {needs_colour(job.template_id) for job in jobs if job.category == "plant"} == {False, True}


def test_redraws_of_scene_unique_plans_stay_unique():
    plan, catalog = _plan("scene"), {"office": ENTRY}
    for planned in expand(plan, catalog):
        for _ in range(8):
            planned = redraw(plan, catalog, planned)
            assert len(referents_of(planned.episode, ENTRY.info)) == 1


def test_a_redraw_that_cannot_change_the_target_changes_the_template():
    """With an unchanged template, every draw of "the sofa" could fail, although "the red sofa" has a valid start."""
    plan, catalog = _plan("view", seen=("plant",)), {"office": ENTRY}
    named = set()
    for planned in expand(plan, catalog)[:20]:
        again = redraw(plan, catalog, planned)
        assert again.episode.target_id == planned.episode.target_id == "plant_001"
        assert again.episode.template_id != planned.episode.template_id
        named.add(needs_colour(again.episode.template_id))
    assert named == {False, True}


def test_a_redraw_of_another_target_keeps_the_template():
    plan, catalog = _plan("view", seen=("chair",)), {"office": ENTRY}
    for planned in expand(plan, catalog)[:20]:
        again = redraw(plan, catalog, planned)
        assert again.episode.target_id != planned.episode.target_id
        assert again.episode.template_id == planned.episode.template_id


def test_the_error_of_a_category_without_a_unique_object_lists_the_unique_objects():
    plan = _plan("scene", seen=("chair", "monitor", "plant"))
    (line,) = find_impossible(plan, {"office": ENTRY})
    assert 'instructions.unique is "scene", but no instruction fits only one monitor;' in line
    assert "unique in the scene: green plant, plant, red chair;" in line
    assert line.endswith('set instructions.unique to "view", or list them in `ambiguous` of the scene')


def test_a_scene_without_unique_objects_is_reported_and_removed_from_the_nearest_plan():
    plan = _plan("scene", seen=("monitor",))
    (line,) = find_impossible(plan, {"office": ENTRY})
    assert "no instruction fits only one monitor; unique in the scene: green plant" in line
    assert find_nearest(plan, {"office": ENTRY}).plan is None
    mixed = find_nearest(_plan("scene", seen=("monitor", "plant")), {"office": ENTRY})
    assert mixed.plan is not None
    assert mixed.plan.scenes[0].seen == ("plant",)
    assert find_impossible(mixed.plan, {"office": ENTRY}) == []


def test_colours_do_not_identify_objects_if_the_plan_names_no_colours():
    plan = _plan("scene").model_copy(update={"colors": "off"})
    (line,) = find_impossible(plan, {"office": ENTRY})
    assert "no instruction fits only one chair; unique in the scene: plant;" in line


def test_categories_listed_as_ambiguous_are_exempt_from_uniqueness():
    jobs = _jobs(_plan("scene", seen=("monitor", "plant"), ambiguous=("monitor",)))
    assert {job.target_id for job in jobs} == {"monitor_001", "monitor_002", "plant_001"}
    shown = [job.start_view for job in _jobs(_plan("view", seen=("monitor",), ambiguous=("monitor",)))]
    assert all(view is not None and view.other_referents == () and view.same_category in {(5,), (6,)} for view in shown)


def test_the_nearest_plan_exempts_only_categories_that_it_names():
    plan = _plan("view", seen=("chair", "sofa"), ambiguous=("chair", "sofa"))
    nearest = find_nearest(plan, {"office": ENTRY}).plan
    assert nearest is not None
    assert (nearest.scenes[0].seen, nearest.scenes[0].ambiguous) == (("chair",), ("chair",))
    assert parse_plan(tomllib.loads(plan_to_toml(nearest)), "nearest") == nearest


def test_ambiguous_categories_must_be_named_by_the_scene():
    with pytest.raises(ValueError, match="neither seen nor held out: rack"):
        _plan("view", ambiguous=("rack",))


def test_a_job_lists_the_other_objects_that_its_instruction_fits():
    for job in _jobs(_plan("view")):
        view, target = job.start_view, ENTRY.info.target(job.target_id)
        assert view is not None
        assert set(view.other_referents) == referents_of(job, ENTRY.info) - {target.instance_id}
        assert set(view.same_category) == ({1, 2, 3} - {target.instance_id} if job.category == "chair" else set())


@pytest.mark.parametrize("unique", ["scene", "view", "off"])
def test_a_target_in_front_of_the_robot_is_within_thirty_degrees_for_every_plan(unique):
    for job in _jobs(_plan(unique)):
        limit = job.start_view and job.start_view.within_rad
        assert limit == (math.radians(30) if "in front of you" in job.instruction else None)


def test_jobs_without_conditions_have_the_json_of_earlier_versions():
    plain = [job for job in _jobs(_plan("off")) if "in front of you" not in job.instruction]
    assert plain
    assert all(job.start_view is None and "start_view" not in job.model_dump_json() for job in plain)
    assert "instructions" not in _plan("off").model_dump_json()
    with_view = plain[0].model_copy(update={"start_view": StartView(other_referents=(3,))})
    assert Job.model_validate_json(with_view.model_dump_json()) == with_view


def test_the_summary_counts_ambiguous_instructions_and_those_with_a_start_that_shows_only_the_target():
    entry = {"office": ENTRY}
    off, view = (summarise(_plan(unique, seen=("monitor", "plant")), entry) for unique in ("off", "view"))
    assert (off.ambiguous, off.shown_alone) == (60, 0)
    assert (view.ambiguous, view.shown_alone) == (60, 60)
    exempt = summarise(_plan("view", seen=("monitor", "plant"), ambiguous=("monitor",)), entry)
    assert (exempt.ambiguous, exempt.shown_alone) == (60, 0)
    assert off.categories == {"monitor": 60, "plant": 60}
    assert off.top_three_share == 1.0
    assert sum(off.templates.values()) == off.episodes == 120


def test_the_summary_of_a_huge_plan_describes_a_reduced_plan():
    plan = Plan(name="x", scenes=(ScenePlan(name="hospital", episodes=5_000_000),), balance="categories")
    summary = summarise(plan, make_catalog(plan))
    assert summary.episodes == 6_000
    assert summary.categories["chair"] == summary.categories["trash_can"] == 2700


ROOM = build_scene(
    (
        *room_walls((-6.0, -4.0), (6.0, 4.0)),
        *(Box((x, 2.0, 0.0), (x + 0.4, 2.4, 0.5), category="crate") for x in (-0.3, 0.3)),
        Box((-0.1, -3.6, 0.0), (0.3, -3.2, 0.5), category="crate"),
    )
)
"""Two crates beside each other, and one at the opposite wall."""


def test_objects_that_no_start_shows_alone_are_not_planned_unless_all_are_so(tmp_path):
    path = tmp_path / "room.scene.zip"
    path.write_bytes(encode_scene(ROOM, level=1))
    entry, scene = read_entry(path), {"name": "room", "usd": "room.usda"}
    pair, single = ROOM.info.targets[:2], ROOM.info.targets[2]
    base = _plan("view", seen=("crate",), **scene).model_copy(update={"tiers": {Tier.NEAR: 1.0}})
    plans = {"view": base, "off": _plan("off", seen=("crate",), **scene).model_copy(update={"tiers": {Tier.NEAR: 1.0}})}
    named = {
        key: {planned.episode.target_id for planned in expand(plan, {"room": entry})} for key, plan in plans.items()
    }
    assert named == {"view": {single.target_id}, "off": {each.target_id for each in (*pair, single)}}
    (row,) = offer_rows(base, {"room": entry})
    assert (row.category, row.objects, row.reachable, row.groups) == ("crate", 1, 3, None)
    (first, *_) = expand(base, {"room": entry})
    assert redraw(base, {"room": entry}, first).episode.target_id == single.target_id
    exempt = _plan("view", seen=("crate",), ambiguous=("crate",), **scene)
    exempt = exempt.model_copy(update={"tiers": {Tier.NEAR: 1.0}})
    assert {planned.episode.target_id for planned in expand(exempt, {"room": entry})} == named["off"]
