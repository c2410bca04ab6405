"""Plans with a language block: permitted requests, drawn targets, and the conditions on the start."""

from __future__ import annotations

import pytest

from coordinator.expansion.builtin import BUILTIN_PLANS
from coordinator.expansion.draw import expand, redraw, to_job
from coordinator.expansion.instances import Side, divide_groups
from coordinator.expansion.plan_file import parse_plan, plan_to_toml
from coordinator.expansion.possible import find_impossible
from coordinator.expansion.summary import summarise
from schemas.errors import InvalidPlan
from schemas.instruction.templates import FROM_START
from schemas.language.compose import explain_impossible
from schemas.language.expression import Family
from schemas.language.language_file import LanguageSpec
from schemas.plan import Plan
from schemas.terms import Tier
from tests.builders.catalog import make_entry, make_target
from tests.builders.language import number_at, two_rooms, views

ENTRY = make_entry("office", [*(make_target("chair", n, n) for n in (1, 2, 3)), make_target("plant", 1, 4)])


def _plan(seen: tuple[str, ...] = ("chair",), **language: object) -> Plan:
    part = {"name": "office", "episodes": 40, "seen": seen}
    return Plan.model_validate({"name": "x", "scenes": [part], "splits": {"train_id": 1}, "language": language})


@pytest.mark.parametrize(
    ("data", "fault"),
    [
        ({"language": {"per_episode": 2}}, "language.per_episode: an episode of a plan has one instruction"),
        ({"language": {"false_premises": 0.1}}, "set splits.test_false_premise"),
        ({"language": {"balanced": True}}, "set `in_view` to 1 or more"),
        ({"language": {"colours": 1}}, "language.colours: no such key"),
        ({"language": {}, "instructions": {"unique": "view"}}, "instructions.unique is for templates"),
        ({"language": {"exchangeable": True}}, "set `in_view` to 1 or more, and remove `balanced`"),
        ({"language": {"exchangeable": True, "in_view": 1, "balanced": True}}, "and remove `balanced`"),
        ({"language": {"exchangeable": True, "in_view": 1}}, "the expert proportional drives straight"),
        ({"language": {"exchangeable": True, "in_view": 1}, "tiers": {"far": 1.0}}, "set tiers.far to 0"),
        ({"language": {"exchangeable": True, "in_view": 1}, "colors": "off"}, "`colors` is for templates, remove it"),
        ({"splits": {"test_false_premise": 1.0}}, "splits.test_false_premise needs the table"),
    ],
)
def test_a_language_block_that_a_plan_does_not_support_is_named(data, fault):
    with pytest.raises(InvalidPlan, match=fault):
        parse_plan({"name": "x", "scenes": [{"name": "office", "episodes": 4}], **data}, "x.toml")


def test_each_mistake_of_a_plan_is_one_line_of_the_error():
    data = {"name": "x", "scenes": [{"name": "office", "episodes": 4}]}
    with pytest.raises(InvalidPlan) as caught:
        parse_plan({**data, "language": {"per_episode": 2, "false_premises": 0.1}}, "x.toml")
    assert [line.split(":")[0] for line in str(caught.value).splitlines()[1:]] == [
        "  - language.per_episode",
        "  - language.false_premises",
    ]


def test_a_plan_without_a_language_block_has_its_former_digest():
    assert "language" not in BUILTIN_PLANS["paper"].model_dump(mode="json")
    assert "language" in plan_to_toml(BUILTIN_PLANS["referring"])


def test_only_categories_with_enough_objects_are_drawn_and_the_error_lists_these_categories():
    (line,) = find_impossible(_plan(("chair", "plant"), same_category=1), {"office": ENTRY})
    assert "categories with fewer: plant; categories with enough objects: chair" in line
    jobs = expand(_plan(same_category=2), {"office": ENTRY})
    assert {job.episode.template_id for job in jobs} == {FROM_START}


def test_the_start_view_requires_another_object_of_the_category_and_each_episode_has_its_own_ranks():
    plan = _plan(in_view=1, balanced=True)
    catalog = {"office": ENTRY}
    found = [to_job(plan, catalog, job, 1).start_view for job in expand(plan, catalog)]
    assert all(view is not None and view.least_same_category == 1 and len(view.same_category) == 2 for view in found)
    assert len({view.ranks for view in found if view is not None}) == len(found)
    assert summarise(plan, catalog).distractors == {2: 40}


def test_the_target_is_drawn_at_the_start_among_the_permitted_objects_of_its_category():
    part = {"name": "office", "episodes": 40, "seen": ("chair",)}
    splits = {"train_id": 0.5, "test_id": 0.5}
    plan = Plan.model_validate(
        {
            "name": "x",
            "scenes": [part],
            "splits": splits,
            "tiers": {"near": 1.0},
            "expert": "planner",
            "disjoint_instances": True,
            "language": {"exchangeable": True, "in_view": 1},
        }
    )
    catalog = {"office": make_entry("office", [make_target("chair", n, n) for n in range(1, 7)])}
    planned = expand(plan, catalog)
    jobs = [to_job(plan, catalog, each, 1) for each in planned]
    choices = [job.choice for job in jobs if job.choice is not None]
    assert len(choices) == 40
    assert len({choice.share for choice in choices}) == 40
    by_split = {split: {job.choice.among for job in jobs if job.split == split and job.choice} for split in splits}
    (train,), (test,) = by_split["train_id"], by_split["test_id"]
    assert sorted(train + test) == [1, 2, 3, 4, 5, 6]
    assert all(job.choice is not None and job.choice.around in job.choice.among for job in jobs)
    again = to_job(plan, catalog, redraw(plan, catalog, planned[0]), 7)
    assert again.choice is not None
    assert again.choice.share == choices[0].share


def test_a_feature_of_limited_share_is_permitted_in_that_share_of_the_episodes():
    spec = LanguageSpec(largest_shares={Family.ORDINAL: 0.3})
    permitted = [Family.ORDINAL in spec.of_episode(index).families for index in range(1, 101)]
    assert sum(permitted) == 30
    assert sum(permitted[:10]) == 3
    assert spec.of_episode(1).largest_shares == {}


def test_both_sides_of_a_plan_get_whole_groups_of_exchangeable_objects():
    targets = [make_target("chair", n, n) for n in range(1, 7)]
    groups = {Tier.NEAR: (frozenset({1, 4}), frozenset({2, 6})), Tier.MID: (frozenset({1, 4}), frozenset({2, 6}))}
    sides = divide_groups(targets, groups, {Side.TRAIN: 30, Side.EVALUATION: 30})
    assert sides["chair_001"] == sides["chair_004"] != sides["chair_002"] == sides["chair_006"]


def test_the_error_of_a_language_block_that_no_target_satisfies_lists_the_possible_features():
    probes = [(number_at(-3.0, 1.6), view) for view in views(2)]
    features = dict.fromkeys(LanguageSpec().families, 0.0) | {"support": 1.0}
    why = explain_impossible(two_rooms(), LanguageSpec(features=features), probes)
    assert "features possible in this scene: " in why
    assert "near" in why
    assert explain_impossible(two_rooms(), LanguageSpec(), probes) == ""
