"""The plan of a merged dataset, and the plans of extensions."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from coordinator.expansion.builtin import BUILTIN_PLANS
from coordinator.expansion.cells import cells, marginal, planned_cells
from coordinator.expansion.plan_file import load_plan, shrink
from coordinator.expansion.scene_cells import scene_cells
from factory.dataset.site import site_of
from factory.merge.extend import plan_extension
from factory.merge.merged_plan import merged_plan
from factory.runs.plan_changes import PlanChanges
from schemas.dataset.meta import DatasetMeta
from schemas.errors import InvalidPlan, UsageError
from schemas.layouts import unseen_layouts
from schemas.plan import Plan, ScenePlan
from schemas.terms import ExpertName, Recording, Split, Tier
from tests.builders.catalog import make_catalog
from tests.builders.dataset import NOW, make_dataset
from tests.builders.plan import small_plan

DEMO = BUILTIN_PLANS["demo"]


def described(root: Path, plan: Plan) -> Path:
    """Writes the description of a finished dataset with a plan; it has no episodes."""
    meta = DatasetMeta(
        run=plan.run,
        plan_digest=plan.digest,
        seed=plan.seed,
        plan=plan,
        scenes={},
        episodes=plan.episodes,
        planned=plan.episodes,
        failed_attempts=0,
        complete=True,
        software={},
        created_at=NOW,
        updated_at=NOW,
    )
    root.mkdir()
    (root / "dataset_meta.json").write_text(meta.model_dump_json())
    return root


@pytest.mark.parametrize("names", [("demo", "balanced"), ("balanced", "referring"), ("demo", "referring")])
def test_a_merged_plan_has_the_marginal_quotas_of_its_sources(names: tuple[str, str]) -> None:
    plans = [BUILTIN_PLANS[name].model_copy(update={"robot": DEMO.robot}) for name in names]
    merged = merged_plan(list(zip(names, plans, strict=True)))
    assert merged.episodes == sum(plan.episodes for plan in plans)
    assert Plan.model_validate_json(merged.model_dump_json()).digest == merged.digest
    wanted: Counter[tuple[str, str]] = Counter()
    for (scene, split, tier), count in planned_cells(plans).items():
        wanted.update({(scene, split): count, (scene, tier): count})
    found: Counter[tuple[str, str]] = Counter()
    for scene in merged.scenes:
        for axis in (0, 1):
            found.update({(scene.name, key): n for key, n in marginal(cells(merged, scene), axis).items()})
    assert found == wanted


def test_families_with_equal_layouts_stay_one_entry_and_others_become_single_layouts() -> None:
    family = ScenePlan(name="home", layouts=2, episodes=4)
    base = small_plan().model_copy(update={"scenes": (family,)})
    same = base.model_copy(update={"seed": 7})
    other = base.model_copy(update={"scenes": (family.model_copy(update={"seed": 10, "episodes": 6}),)})
    assert [scene.name for scene in merged_plan([("a", base), ("b", same)]).scenes] == ["home"]
    names = [scene.name for scene in merged_plan([("a", base), ("b", other)]).scenes]
    assert names == ["home_00000", "home_00001", "home_00010", "home_00011"]


def test_plans_that_readers_would_interpret_differently_are_refused_with_both_values() -> None:
    task = DEMO.task.model_copy(update={"success_radius_m": 2.0})
    with pytest.raises(UsageError, match=r"differ in task.*\n  - task.success_radius_m: recorded 1.0, requested 2.0"):
        merged_plan([("a", DEMO), ("b", DEMO.model_copy(update={"task": task, "seed": 3}))])
    with pytest.raises(UsageError, match=r"render the frames of b with `factory render STATES -o FRAMES`"):
        merged_plan([("a", DEMO), ("b", shrink(DEMO, record=Recording.STATES))])


def test_plans_that_train_on_what_another_one_holds_out_are_refused() -> None:
    one = small_plan().model_copy(update={"scenes": (ScenePlan(name="office", episodes=3, seen=("chair",)),)})
    other = ScenePlan(name="office", episodes=3, seen=("table",), held_out=("chair",))
    with pytest.raises(UsageError, match="a trains on chair in office, but b holds the category out"):
        merged_plan([("a", one), ("b", one.model_copy(update={"scenes": (other,)}))])
    splits = {Split.TRAIN_ID: 0.5, Split.TEST_UNSEEN_SCENE: 0.5}
    first, second = (
        one.model_copy(update={"splits": splits, "scenes": (ScenePlan(name="home", layouts=4, episodes=8, seed=seed),)})
        for seed in (0, 2)
    )
    with pytest.raises(UsageError, match="b trains in the layout home_00002, but a keeps it for test_unseen_scene"):
        merged_plan([("a", first), ("b", second)])


@pytest.mark.parametrize("name", ["demo", "paper", "balanced", "referring"])
@pytest.mark.parametrize(("episodes", "more"), [(8, 12), (16, 100), (101, 103)])
def test_an_extension_has_the_exact_difference_of_the_quotas(
    tmp_path: Path, name: str, episodes: int, more: int
) -> None:
    plan = shrink(BUILTIN_PLANS[name], episodes=episodes)
    root = described(tmp_path / "data", plan)
    extension = plan_extension(None, site_of(root), PlanChanges(episodes=more))
    assert extension is not None
    assert (extension.whole.episodes, extension.added.episodes) == (more, more - episodes)
    assert extension.added.seed != plan.seed
    for scene in extension.whole.scenes:
        parts = [(plan, plan.scenes), (extension.added, extension.added.scenes)]
        for axis in (0, 1):
            joined: Counter[Split | Tier] = Counter()
            for owner, scenes in parts:
                for each in scenes:
                    joined += marginal(cells(owner, each), axis) if each.name == scene.name else Counter()
            assert joined == marginal(cells(extension.whole, scene), axis)


def test_an_extension_is_deterministic_and_named_plans_extend_like_numbers(tmp_path: Path) -> None:
    root = described(tmp_path / "data", shrink(DEMO, episodes=8))
    by_number = plan_extension(None, site_of(root), PlanChanges(episodes=12))
    by_name = plan_extension("demo", site_of(root), PlanChanges(episodes=12))
    assert by_number is not None
    assert by_name is not None
    assert by_name.added.digest == by_number.added.digest
    assert plan_extension("demo", site_of(root), PlanChanges(episodes=8)) is None


def test_an_extension_by_a_changed_plan_names_the_changed_keys(tmp_path: Path) -> None:
    root = described(tmp_path / "data", shrink(DEMO, episodes=8))
    with pytest.raises(UsageError, match=r'(?s)numbers of episodes only.*\n  - expert: recorded "proportional", req'):
        plan_extension("demo", site_of(root), PlanChanges(episodes=12, expert=ExpertName.PLANNER))
    with pytest.raises(UsageError, match="removes no"):
        plan_extension("demo", site_of(root), PlanChanges(episodes=4))
    with pytest.raises(UsageError, match="omit: --seed"):
        plan_extension(None, site_of(root), PlanChanges(episodes=12, seed=3))
    with pytest.raises(UsageError, match="needs the new number of episodes"):
        plan_extension(None, site_of(root), PlanChanges())


def test_an_extension_keeps_the_layouts_that_only_unseen_splits_use(tmp_path: Path) -> None:
    splits = {Split.TRAIN_ID: 0.75, Split.TEST_UNSEEN_SCENE: 0.25}
    family = ScenePlan(name="home", layouts=4, episodes=8)
    plan = small_plan().model_copy(update={"splits": splits, "scenes": (family,)})
    root = described(tmp_path / "data", plan)
    extension = plan_extension(None, site_of(root), PlanChanges(episodes=20))
    assert extension is not None
    (scene,) = extension.added.scenes
    assert unseen_layouts(scene, extension.added.splits_of(scene)) == unseen_layouts(family, splits) == 1
    kinds = [{part.name: part.is_unseen for part in each.parts} for each in (plan, extension.added)]
    assert kinds[0] == kinds[1]
    with pytest.raises(UsageError, match=r"test_unseen_scene\* splits need at least 1 more episodes, not 0"):
        plan_extension(None, site_of(root), PlanChanges(episodes=10))


def test_the_instances_of_an_extension_have_the_sides_of_the_dataset(tmp_path: Path) -> None:
    splits = {Split.TRAIN_ID: 0.75, Split.TEST_ID: 0.25}
    plan = small_plan(8).model_copy(update={"splits": splits, "disjoint_instances": True})
    extension = plan_extension(None, site_of(described(tmp_path / "data", plan)), PlanChanges(episodes=9))
    assert extension is not None
    added, entry = extension.added, make_catalog(plan)["office"]
    assert len(cells(added, added.scenes[0])) == 1  # alone, it would not separate the sides
    sides = [scene_cells(each, each.parts[0], entry).sides for each in (plan, added)]
    assert sides[0] == sides[1] != {}


def test_datasets_that_cannot_be_extended_are_refused_with_the_remedy(tmp_path: Path) -> None:
    make_dataset(tmp_path / "short", 2, planned=3)
    with pytest.raises(UsageError, match=r"has 2 of 3 episodes: finish it with `factory run --out"):
        plan_extension(None, site_of(tmp_path / "short"), PlanChanges(episodes=5))


def test_a_plan_file_cannot_set_the_plan_that_it_extends(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('extends = "{}"\n[[scenes]]\nname = "office"\nepisodes = 3\n')
    with pytest.raises(InvalidPlan, match="only `factory run --extend` sets this key"):
        load_plan(str(file))
