"""Assignment of a family's episodes to layouts: uses the plan only, has exact quotas, separates unseen layouts."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import pytest
from pydantic import ValidationError

from coordinator.expansion.balance import planned_categories
from coordinator.expansion.cells import cells
from coordinator.expansion.draw import expand, expand_layout, redraw, to_job
from coordinator.expansion.plan_file import parse_plan, plan_to_toml, shrink
from coordinator.expansion.possible import find_impossible
from schemas.errors import InvalidPlan
from schemas.layouts import LayoutPlan
from schemas.plan import Plan, ScenePlan
from schemas.support.toml_file import read_toml
from schemas.terms import Split, Tier
from tests.builders.catalog import make_catalog, make_entry

SPLITS = {
    Split.TRAIN_ID: 0.5,
    Split.TEST_ID: 0.1,
    Split.TEST_OOD_OBJ: 0.1,
    Split.TEST_UNSEEN_SCENE: 0.2,
    Split.TEST_UNSEEN_SCENE_OOD_OBJ: 0.1,
}


def family_plan(layouts: int = 7, episodes: int = 200, balance: str = "categories_overall", **scene: object) -> Plan:
    home = {"name": "home", "layouts": layouts, "episodes": episodes, "seed": 10, **scene}
    return Plan.model_validate(
        {"name": "x", "scenes": [home, {"name": "office", "episodes": 20, "splits": {"train_id": 1}}]}
        | {"splits": SPLITS, "balance": balance}
    )


def test_every_cell_of_a_family_has_its_quota_and_layouts_differ_by_one_episode() -> None:
    plan = family_plan()
    quota, dealt = cells(plan, plan.scenes[0]), Counter[tuple[Split, Tier]]()
    layouts = [part for part in plan.parts if isinstance(part, LayoutPlan)]
    for part in layouts:
        dealt.update(cells(plan, part))
    assert dealt == quota
    assert [part.name for part in plan.parts] == [*(f"home_{seed:05d}" for seed in range(10, 17)), "office"]
    for is_unseen in (False, True):
        group = [part for part in layouts if part.is_unseen is is_unseen]
        assert max(part.episodes for part in group) - min(part.episodes for part in group) <= 1
        for cell in quota:
            counts = [cells(plan, part).get(cell, 0) for part in group]
            assert max(counts) - min(counts) <= 1


def test_layouts_of_unseen_scenes_have_no_episode_of_another_split() -> None:
    plan = family_plan()
    uses: dict[str, set[bool]] = {}
    for job in expand(plan, make_catalog(plan)):
        uses.setdefault(job.episode.scene, set()).add(job.episode.split.is_unseen_scene)
    assert all(len(kinds) == 1 for kinds in uses.values())
    assert {name for name, kinds in uses.items() if True in kinds} == {"home_00015", "home_00016"}


def test_a_layout_is_expanded_from_its_own_package_to_the_same_jobs_as_in_the_whole_plan() -> None:
    plan = family_plan()
    catalog = make_catalog(plan)
    whole = [job for job in expand(plan, catalog) if job.episode.scene == "home_00012"]
    first = 1 + sum(part.episodes for part in plan.parts[:2])
    assert list(expand_layout(plan, 2, first, catalog["home_00012"])) == whole
    assert [job.index for job in expand(plan, catalog)] == list(range(1, plan.episodes + 1))


def test_category_counts_of_a_family_differ_by_at_most_one_over_all_layouts() -> None:
    plan = family_plan()
    jobs = [job.episode for job in expand(plan, make_catalog(plan)) if job.episode.scene.startswith("home")]
    for is_held_out in (False, True):
        counts = Counter(each.category for each in jobs if each.split.is_held_out is is_held_out)
        names = plan.scenes[0].categories[is_held_out]
        assert set(counts) == set(names)
        assert max(counts.values()) - min(counts.values()) <= 1


def test_the_planned_category_counts_of_layouts_equal_the_drawn_counts() -> None:
    plan = family_plan()
    drawn = Counter(job.episode.category for job in expand(plan, make_catalog(plan)) if job.episode.scene != "office")
    assert planned_categories(plan) == drawn
    assert not planned_categories(family_plan(balance="instances"))


def test_a_layout_without_targets_for_its_category_quota_is_refused_only_if_the_quota_is_exact() -> None:
    exact, loose = family_plan(), family_plan(balance="categories")
    catalog = make_catalog(exact)
    entry = catalog["home_00010"]
    near = [
        target.model_copy(update={"connected_tiers": (Tier.NEAR,), "straight_tiers": (Tier.NEAR,)})
        if target.category == "sofa"
        else target
        for target in entry.info.targets
    ]
    parts = [part for part in exact.parts if isinstance(part, LayoutPlan)]
    lacking = catalog | {part.name: make_entry(part.name, near) for part in parts}
    assert any("sofa, which its quota needs" in line for line in find_impossible(exact, lacking))
    assert find_impossible(loose, lacking) == []
    assert len(expand(loose, lacking)) == loose.episodes


def test_redraws_and_jobs_of_a_layout_keep_the_layout() -> None:
    plan = family_plan()
    catalog = make_catalog(plan)
    planned = expand(plan, catalog)[0]
    again = redraw(plan, catalog, planned)
    assert again.episode.scene == planned.episode.scene == to_job(plan, catalog, again, 2).scene == "home_00010"


def test_the_metadata_of_a_layout_is_the_same_if_it_is_read_again() -> None:
    entry = make_catalog(family_plan())["home_00010"]
    assert replace(entry, known=entry.info).info == entry.info


def test_a_plan_with_layouts_is_read_back_from_json_and_toml(tmp_path_factory: pytest.TempPathFactory) -> None:
    plan = family_plan(unseen_layouts=3)
    assert Plan.model_validate_json(plan.model_dump_json()).digest == plan.digest
    file = tmp_path_factory.mktemp("plan") / "x.toml"
    file.write_text(plan_to_toml(plan))
    assert parse_plan(read_toml(file, "plan", InvalidPlan), "x").digest == plan.digest
    assert sum(part.is_unseen for part in plan.parts if isinstance(part, LayoutPlan)) == 3


@pytest.mark.parametrize("episodes", [1, 2, 5, 9, 40])
def test_a_reduced_plan_has_fewer_layouts_and_is_valid(episodes: int) -> None:
    part = shrink(family_plan(), episodes=episodes)
    assert Plan.model_validate_json(part.model_dump_json()).digest == part.digest
    assert sum(scene.episodes for scene in part.parts) == episodes


def test_a_numbered_scene_has_its_number_as_seed_and_the_categories_of_its_family() -> None:
    scene = ScenePlan.model_validate({"name": "home_00017", "episodes": 4})
    assert scene.seed == 17
    assert scene.categories == ScenePlan(name="home", episodes=4).categories


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        ({"name": "mine", "file": "a.usd", "seen": ["chair"], "layouts": 3}, "'mine' is one fixed scene"),
        ({"name": "home_00017", "layouts": 3}, "'home_00017' is one fixed scene"),
        ({"name": "home", "layouts": 41}, "41 layouts need at least 41 episodes, not 40"),
        ({"name": "home", "layouts": 0}, "greater than or equal to 1"),
        ({"name": "home", "layouts": 3, "targets": "a.yaml"}, "`targets` edits one layout"),
        ({"name": "home", "unseen_layouts": 3}, "`unseen_layouts` needs `layouts`"),
        ({"name": "home", "layouts": 4, "unseen_layouts": 4}, "need 1 to 28 layouts, not 0"),
        ({"name": "home", "layouts": 30, "unseen_layouts": 13}, "need 1 to 12 layouts, not 13"),
        ({"name": "home"}, "the splits test_unseen_scene* need `layouts`"),
        ({"name": "home_00017"}, "one layout cannot have the splits test_unseen_scene* and others"),
        ({"name": "home", "layouts": 3, "unseen_layouts": 1, "splits": {"train_id": 1}}, "`unseen_layouts` has no use"),
    ],
)
def test_layouts_that_contradict_the_plan_are_refused(scene: dict[str, object], message: str) -> None:
    with pytest.raises(ValidationError) as error:
        Plan.model_validate({"name": "x", "scenes": [{"episodes": 40, **scene}], "splits": SPLITS})
    assert message in str(error.value)
