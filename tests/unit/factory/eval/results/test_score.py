"""Tables of results: counts, order of groups, ablation gaps, paired comparisons."""

from __future__ import annotations

import pytest

from factory.eval.driving.rollout import progresses
from factory.eval.models.result import EvalEnd, Variant
from factory.eval.policies.registry import PolicyNote
from factory.eval.results.compare import compare
from factory.eval.results.score import score_policy
from schemas.config import TaskConfig
from schemas.errors import UsageError
from schemas.terms import Split, Tier
from tests.builders.eval_results import result_of

NOTE = PolicyNote(policy="m:P", knows="camera and instruction", reads_instruction=True, renderer="", software={})


def test_a_score_counts_each_termination_once_and_averages_the_measures() -> None:
    rows = [
        result_of(1, trajectory_length_m=2.0, spl=0.8),
        result_of(2, success=False, end=EvalEnd.COLLISION, contact_steps=20, any_instance=True),
        result_of(3, success=False),
        result_of(4, success=False, end=EvalEnd.POLICY_INVALID),
    ]
    found = score_policy("m:P", rows, NOTE).overall
    shares = (found.success, found.any_instance, found.collision, found.timeout, found.policy_failure, found.contact)
    assert [share.count for share in shares] == [1, 2, 1, 1, 1, 1]
    assert {share.of for share in shares} == {4}
    assert found.success.low == pytest.approx(0.0456, abs=1e-4)  # Wilson interval of 1 of 4
    assert found.spl.mean == pytest.approx(0.2)
    assert found.ne_m.mean == pytest.approx(2.5)


def test_episodes_without_a_floor_path_are_excluded_only_from_spl() -> None:
    rows = [result_of(1), result_of(2, geodesic_m=None, spl=None, soft_spl=None)]
    found = score_policy("m:P", rows, NOTE).overall
    assert (found.spl.n, found.soft_spl.n, found.ne_m.n) == (1, 1, 2)


def test_groups_follow_the_papers_order_and_contain_every_row_once() -> None:
    rows = [
        result_of(1, split=Split.TEST_OOD_OBJ, tier=Tier.FAR, category="zebra"),
        result_of(2, split=Split.TEST_ID, tier=Tier.NEAR, category="sofa", categories_in_view=2),
        result_of(3, split=Split.TEST_ID, tier=Tier.MID, category="chair", categories_in_view=3),
    ]
    groups = score_policy("m:P", rows, NOTE).groups
    names = {by: [g.group for g in groups if g.by == by] for by in ("split", "tier", "category", "view")}
    assert names["split"] == ["test_id", "test_ood_obj"]
    assert names["tier"] == ["near", "mid", "far"]
    assert names["category"] == ["chair", "sofa", "zebra"]
    assert [g.n for g in groups if g.by == "view"] == [2, 1]
    for by in ("split", "scene", "tier", "category", "template", "view"):
        assert sum(group.n for group in groups if group.by == by) == 3


def test_the_ablation_gap_is_computed_from_paired_episodes() -> None:
    rows = [result_of(n, categories_in_view=2 if n <= 2 else 1) for n in range(1, 7)]
    rows += [
        result_of(n, success=n > 4, variant=Variant.WRONG, instruction="Go to the sofa.", categories_in_view=1)
        for n in range(1, 6)
    ]
    everything, grounded = score_policy("m:P", rows, NOTE).ablation
    assert (everything.variant, everything.n, everything.success.count) == (Variant.WRONG, 5, 1)
    assert everything.gap.mean == pytest.approx(0.8)
    assert everything.p == pytest.approx(2 * 0.5**4)
    assert (grounded.by, grounded.n, grounded.gap.mean) == ("view", 2, 1.0)


def test_a_comparison_counts_the_four_kinds_of_pairs_and_omitted_episodes() -> None:
    first = [result_of(n, success=n in {1, 2}) for n in (1, 2, 3, 4, 9)]
    second = [result_of(n, success=n in {1, 3, 4}, policy="stop") for n in (1, 2, 3, 4)]
    found = compare(first, second, Variant.ORIGINAL)
    assert (found.both, found.only_first, found.only_second, found.neither) == (1, 1, 2, 0)
    assert (found.pairs, found.left_out) == (4, 1)
    assert found.success_difference.mean == pytest.approx(0.25)
    assert found.p == 1.0
    assert found.differences["ne_m"].mean == pytest.approx(-0.5)


def test_results_on_different_specs_are_not_compared() -> None:
    with pytest.raises(UsageError, match="no original episode in common"):
        compare([result_of(1)], [result_of(2)], Variant.ORIGINAL)
    with pytest.raises(UsageError, match="same --specs"):
        compare([result_of(1)], [result_of(1, instruction="Go to the sofa.")], Variant.ORIGINAL)


def test_oracle_success_counts_episodes_that_were_within_the_radius_at_any_time() -> None:
    inside = progresses(start_m=3.0, final_m=2.5, least_m=1.0, task=TaskConfig(success_radius_m=1.0))
    outside = progresses(start_m=3.0, final_m=2.5, least_m=1.001, task=TaskConfig(success_radius_m=1.0))
    rows = [
        result_of(1),
        result_of(2, success=False, min_ne_m=1.0, **inside),
        result_of(3, success=False, min_ne_m=1.001, **outside),
        result_of(4, success=False),
    ]
    assert [row.oracle_success for row in rows] == [True, True, False, False]
    overall = score_policy("m:P", rows, NOTE).overall
    assert (overall.oracle_success.share, overall.success.share) == (0.5, 0.25)
