"""Balance of categories over all scenes: exchanging episodes between categories finds the most even distribution."""

from __future__ import annotations

from collections import Counter
from itertools import combinations_with_replacement, product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coordinator.expansion.balance import level
from coordinator.expansion.builtin import BUILTIN_PLANS
from coordinator.expansion.cells import cells
from coordinator.expansion.draw import expand, redraw
from coordinator.expansion.plan_file import shrink
from schemas.plan import PAPER_SPLITS, Plan, ScenePlan
from schemas.terms import Split, Tier
from tests.builders.catalog import make_catalog, make_entry, make_target

BALANCED = BUILTIN_PLANS["balanced"]
NAMES = ("a", "b", "c", "d")
places = st.lists(st.tuples(st.integers(0, 4), st.sets(st.sampled_from(NAMES), min_size=1)), min_size=1, max_size=3)


def _squares(totals: Counter[str]) -> int:
    return sum(count * count for count in totals.values())


def _best(counts: list[int], options: list[list[str]]) -> int:
    """Returns the smallest sum of squares over all distributions."""
    ways = [list(combinations_with_replacement(names, count)) for count, names in zip(counts, options, strict=True)]
    return min(_squares(Counter(name for part in way for name in part)) for way in product(*ways))


@settings(max_examples=60, deadline=None)
@given(places)
def test_no_other_distribution_is_more_even(drawn):
    counts, options = [count for count, _ in drawn], [sorted(names) for _, names in drawn]
    shares = {number: Counter({names[0]: counts[number]}) for number, names in enumerate(options)}
    totals: Counter[str] = sum(shares.values(), Counter())
    level(shares, options, totals)
    assert [share.total() for share in shares.values()] == counts
    assert all(set(+share) <= set(options[number]) and min(share.values()) >= 0 for number, share in shares.items())
    assert +totals == +sum((+share for share in shares.values()), Counter())
    assert _squares(totals) == _best(counts, options)


def _categories(plan: Plan, **conditions: object) -> Counter[str]:
    specs = [job.episode for job in expand(plan, make_catalog(plan, colour="unknown"))]
    return Counter(s.category for s in specs if all(getattr(s, key) == value for key, value in conditions.items()))


def test_the_balanced_plan_has_equal_category_counts_over_all_scenes_and_in_every_split():
    counts = _categories(BALANCED)
    assert sorted(counts.values()) == [30] * 4 + [135] * 8
    assert sum(count for _, count in counts.most_common(3)) <= 0.35 * BALANCED.episodes
    for split in set(PAPER_SPLITS) - {Split.TEST_OOD_OBJ}:
        assert len(set(_categories(BALANCED, split=split).values())) == 1


def test_every_scene_of_the_balanced_plan_has_each_of_its_categories_in_training():
    for scene in BALANCED.scenes:
        assert set(_categories(BALANCED, scene=scene.name, split=Split.TRAIN_ID)) == set(scene.categories.seen)


@pytest.mark.parametrize("episodes", [24, 40, 120, 240])
def test_category_counts_of_a_reduced_balanced_plan_differ_by_at_most_one(episodes):
    plan = shrink(BALANCED, episodes=episodes)
    counts = _categories(plan)
    held_out = {name for scene in plan.scenes for name in scene.categories.held_out}
    for names in (held_out, set(counts) - held_out):
        assert max(counts[name] for name in names) - min(counts[name] for name in names) <= 1


def test_levelling_keeps_the_exact_quota_of_every_cell():
    plan = shrink(BALANCED, episodes=120)
    jobs = expand(plan, make_catalog(plan))
    for scene in plan.scenes:
        of_scene = Counter((j.episode.split, j.episode.tier) for j in jobs if j.episode.scene == scene.name)
        assert of_scene == cells(plan, scene)


def test_balance_over_all_scenes_draws_a_common_category_only_in_the_scene_without_other_categories():
    train = {Split.TRAIN_ID: 1.0}
    scenes = (
        ScenePlan(name="office", episodes=30, seen=("chair", "sofa", "table")),
        ScenePlan(name="hospital", episodes=30, seen=("chair",)),
    )
    plan = Plan(name="x", scenes=scenes, tiers={Tier.NEAR: 1.0}, splits=train, balance="categories_overall")
    assert _categories(plan) == {"chair": 30, "sofa": 15, "table": 15}
    assert _categories(plan.model_copy(update={"balance": "categories"})) == {"chair": 40, "sofa": 10, "table": 10}


def test_redraws_of_a_balanced_plan_keep_the_category_for_the_first_half_of_the_draws():
    plan = shrink(BALANCED, episodes=24)
    catalog = make_catalog(plan, per_category=2)
    for job in expand(plan, catalog):
        following = job
        for _ in range(plan.budget.draws // 2):
            following = redraw(plan, catalog, following)
            assert following.episode.category == job.episode.category


def test_a_redraw_of_a_balanced_plan_changes_the_template_if_the_category_has_a_single_instance():
    plan = Plan(
        name="x",
        scenes=(ScenePlan(name="hospital", episodes=4),),
        splits={Split.TRAIN_ID: 1.0},
        balance="categories_overall",
    )
    catalog = {"hospital": make_entry("hospital", [make_target("chair", 1, 1), make_target("trash_can", 1, 2)])}
    for job in expand(plan, catalog):
        again = redraw(plan, catalog, job).episode
        assert again.target_id == job.episode.target_id
        assert again.template_id != job.episode.template_id
