"""Comparison with the paper: every difference is correct, and its reason contains the numbers."""

from __future__ import annotations

import re
from typing import Any

import pytest

from factory.report.comparison.paper_comparison import PaperComparison, verdict_of
from factory.report.comparison.reasons import facts_of
from factory.report.comparison.rows import compare
from factory.report.data import Drives, ReportInput
from factory.stats import compute_statistics
from schemas.terms import Split, Tier
from tests.builders.dataset import failure
from tests.builders.statistics import episode_row, rows_of, two_scenes

OFFICE_RATE = "first near and mid attempts that succeed, office"
SHARE_OF_THREE = "share of the three most frequent categories"


def material(episodes: list[Any], failures: list[Any] | None = None) -> ReportInput:
    rows = rows_of(episodes, failures, two_scenes(max(len(episodes), 1)))
    return ReportInput(rows.meta, compute_statistics("run", rows, compare_paper=True), episodes, failures, Drives(), {})


def drive(index: int, spawn: float, length: float, error: float = 0.967, **changes: Any) -> Any:
    values = {"spawn_dist_m": spawn, "trajectory_length_m": length, "final_ne_m": error, "num_steps": 120}
    return episode_row(index, **values | changes)


def found(episodes: list[Any], what: str, failures: list[Any] | None = None) -> PaperComparison:
    (row,) = [row for row in compare(material(episodes, failures)) if row.what == what]
    return row


def test_a_length_is_the_straight_distance_plus_the_detour() -> None:
    facts = facts_of([drive(1, 2.0, 1.2), drive(2, 3.0, 2.1, 0.95)])
    assert facts is not None
    assert facts.tl_m == pytest.approx(facts.spawn_m - facts.ne_m + facts.detour_m)
    assert facts.detour_m == pytest.approx((1.2 - 1.033 + 2.1 - 2.05) / 2)


def test_the_reason_of_a_length_adds_up_to_the_difference() -> None:
    row = found([drive(1, 2.0, 1.05), drive(2, 2.2, 1.25)], "TL mean, near")
    here, there, shift, detour = map(float, re.findall(r"[+−]?\d+\.\d+", row.reason.replace("−", "-"))[:4])
    assert (here, there) == (2.1, 2.53)
    assert row.difference == pytest.approx(1.15 - 1.56)
    assert abs(shift) == pytest.approx(there - here, abs=0.011)
    assert here - 0.967 + detour == pytest.approx(1.15, abs=0.011)


def test_a_length_equal_to_the_papers_has_no_reason() -> None:
    row = found([drive(1, 2.527, 1.56)], "TL mean, near")
    assert row.reason == ""
    assert row.ratio == pytest.approx(1.0)


def test_the_overall_length_is_weighted_by_the_papers_tiers() -> None:
    lengths = {Tier.NEAR: 1.0, Tier.MID: 4.0, Tier.FAR: 9.0}
    episodes = [drive(n, 1 + length, length, spawn_tier=tier) for n, (tier, length) in enumerate(lengths.items(), 1)]
    reason = found(episodes, "TL mean, all").reason
    assert f"{0.545 * 1 + 0.443 * 4 + 0.012 * 9:.2f} m" in reason


def test_a_missing_tier_is_reported_instead_of_weighted() -> None:
    assert (
        "There are no mid episodes, so the mean cannot be weighted"
        in found([drive(1, 6.0, 5.0)], "TL mean, all").reason
    )


def test_a_rate_within_the_papers_range_has_no_difference() -> None:
    failures = [failure(1).model_copy(update={"reason": "collision"})]
    row = found([episode_row(n) for n in range(1, 6)], OFFICE_RATE, failures)
    assert (row.ours, row.difference, row.reason) == (pytest.approx(5 / 6), 0, "")


def test_the_explanation_of_a_rate_outside_the_papers_range_names_the_failure_reasons() -> None:
    failures = [failure(1, attempt).model_copy(update={"reason": "collision"}) for attempt in (1, 2, 3)]
    row = found([episode_row(1, attempt=4)], OFFICE_RATE, failures)
    assert (row.ours, row.difference) == (0, pytest.approx(-0.8))
    assert "1 of 4 attempts succeeded (3 collision)" in row.reason
    assert "0.10 m" in row.reason


@pytest.mark.parametrize(
    ("interval", "verdict"),
    [
        ((0.93, 0.95), "inside"),
        ((0.92, 0.96), "inside"),
        ((0.91, 0.95), "undecided"),
        ((0.95, 0.99), "undecided"),
        ((0.5, 1.0), "undecided"),
        ((0.97, 0.99), "outside"),
        ((0.1, 0.2), "outside"),
        (None, None),
    ],
)
def test_a_verdict_is_the_position_of_the_interval_relative_to_the_target(
    interval: tuple[float, float] | None, verdict: str | None
) -> None:
    assert verdict_of(interval, (0.92, 0.96)) == verdict


def of_tier(tier: Tier, mean_m: float, half_m: float, n: int = 60) -> list[Any]:
    """Returns drives of a tier whose lengths alternate between `mean_m - half_m` and `mean_m + half_m`."""
    return [drive(k, 6.0, mean_m + half_m * (-1) ** k, spawn_tier=tier) for k in range(1, n + 1)]


def test_the_target_of_lengths_and_steps_is_5_percent_of_the_published_number() -> None:
    row = found(of_tier(Tier.NEAR, 1.56, 0.1), "TL mean, near")
    half = 1.960 * 0.1 / 60**0.5
    assert row.target == pytest.approx((1.56 * 0.95, 1.56 * 1.05))
    assert row.interval == pytest.approx((1.56 - half, 1.56 + half), abs=0.002)
    assert row.verdict == "inside"
    assert found(of_tier(Tier.NEAR, 1.56 * 1.05, 0.1), "TL mean, near").verdict == "undecided"
    assert found(of_tier(Tier.NEAR, 1.56 * 1.15, 0.1), "TL mean, near").verdict == "outside"


def test_the_target_of_far_starts_is_15_percent_of_the_published_number() -> None:
    row = found(of_tier(Tier.FAR, 4.46 * 1.1, 0.1), "TL mean, far")
    assert (row.verdict, row.reason) == ("inside", "")
    assert row.target == pytest.approx((4.46 * 0.85, 4.46 * 1.15))
    steps = found(of_tier(Tier.FAR, 4.46, 0.1), "steps mean, far")
    assert (steps.ours, steps.verdict) == (120, "outside")
    assert steps.target == pytest.approx((414.6 * 0.85, 414.6 * 1.15))


def test_the_targets_of_r_and_ne_are_those_of_the_paper_plan() -> None:
    straight = [drive(k, 2.0 + 0.1 * k, 1.0 + 0.1 * k, 0.967) for k in range(1, 40)]
    r = found(straight, "Pearson r")
    assert r.target == pytest.approx((0.92, 0.96))
    assert (r.ours, r.verdict) == (pytest.approx(1.0), "outside")
    error = found(straight, "NE mean")
    assert error.target == pytest.approx((0.962, 0.972))
    assert error.verdict == "inside"


def test_success_of_first_attempts_has_a_wilson_interval_and_the_published_range_as_target() -> None:
    failures = [failure(k).model_copy(update={"reason": "collision"}) for k in range(1, 151)]
    row = found([episode_row(n) for n in range(1, 851)], OFFICE_RATE, failures)
    assert (row.ours, row.target, row.verdict) == (0.85, (0.8, 0.9), "inside")
    assert row.interval == pytest.approx((0.8265, 0.8708), abs=0.0005)
    few = found([episode_row(n) for n in range(1, 18)], OFFICE_RATE, failures[:3])
    assert (few.ours, few.verdict) == (0.85, "undecided")


def test_far_starts_do_not_count_in_the_published_success_rates() -> None:
    failures = [failure(k).model_copy(update={"reason": "collision", "spawn_tier": Tier.FAR}) for k in range(1, 31)]
    row = found([episode_row(n) for n in range(31, 41)], OFFICE_RATE, failures)
    assert row.ours == 1.0


def test_the_share_of_the_three_most_frequent_categories_has_an_interval() -> None:
    names = ["monitor"] * 5 + ["chair"] * 3 + ["sofa"] * 2 + ["table"] * 2
    row = found([episode_row(n, target_category=name) for n, name in enumerate(names, 1)], SHARE_OF_THREE)
    assert (row.ours, row.verdict) == (pytest.approx(10 / 12), "undecided")
    assert row.interval == pytest.approx((0.552, 0.953), abs=0.001)


def test_the_explanation_of_a_share_states_the_share_that_the_plan_requests() -> None:
    row = found([episode_row(1, split=Split.TEST_ID)], "share of test_id")
    assert row.published == pytest.approx(121 / 1174)
    assert row.reason.startswith("The plan requests 10 %")


def test_the_explanation_of_a_share_states_its_value_after_rounding_for_a_small_plan() -> None:
    row = found([episode_row(1)], "share of train_id")  # the plan has 2 episodes, 1 in each scene
    assert row.reason.startswith(
        "The plan requests 60 % (100 % after rounding to its 2 episodes); 1 of 2 generated so far"
    )


def test_an_empty_dataset_has_no_comparison() -> None:
    assert compare(material([])) == ()


def test_every_noticeable_difference_of_lengths_and_steps_has_a_reason() -> None:
    rows = compare(material([drive(1, 6.0, 5.5), drive(2, 7.0, 6.6, scene="hospital")]))
    silent = [
        row.what
        for row in rows
        if row.unit in {"m", "steps"} and row.ratio and abs(row.ratio - 1) > 0.05 and not row.reason
    ]
    assert not silent
