"""Each statistic compared with hand-computed values and with scipy."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy import stats

from factory.stats.measures import deviation_of, fit_line, mean_of, median_of, quantiles_of, share_of


def test_mean_median_and_deviation_equal_hand_computed_values() -> None:
    values = [2.0, 4.0, 4.0, 10.0]
    assert mean_of(values) == 5.0
    assert median_of(values) == 4.0
    assert deviation_of(values) == pytest.approx((36 / 3) ** 0.5)  # (9 + 1 + 1 + 25) / (n - 1)


def test_empty_data_have_no_mean_and_one_value_has_no_deviation() -> None:
    assert mean_of([]) is None
    assert median_of([]) is None
    assert quantiles_of([]) == {}
    assert deviation_of([1.0]) is None


def test_quantiles_run_linearly_from_smallest_to_largest() -> None:
    found = quantiles_of(list(range(101)))
    assert found == {"p00": 0, "p05": 5, "p25": 25, "p50": 50, "p75": 75, "p95": 95, "p100": 100}


def test_wilson_interval_agrees_with_the_textbook_formula() -> None:
    share, z, n = share_of(40, 50), 1.959964, 50
    centre = (0.8 + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * (0.8 * 0.2 / n + z**2 / (4 * n**2)) ** 0.5
    assert share.share == 0.8
    assert share.low == pytest.approx(centre - half, abs=1e-6)
    assert share.high == pytest.approx(centre + half, abs=1e-6)


@pytest.mark.parametrize(("count", "of", "low", "high"), [(0, 10, 0.0, 0.2775), (10, 10, 0.7225, 1.0)])
def test_intervals_of_extreme_shares_stay_between_zero_and_one(count: int, of: int, low: float, high: float) -> None:
    share = share_of(count, of)
    assert (share.low, share.high) == (pytest.approx(low, abs=1e-4), pytest.approx(high, abs=1e-4))


def test_the_share_of_no_trials_is_undefined() -> None:
    share = share_of(0, 0)
    assert (share.share, share.low, share.high) == (None, None, None)


def test_correlation_equals_hand_computed_values() -> None:
    fit = fit_line("all", [1.0, 2.0, 3.0, 4.0], [1.0, 3.0, 2.0, 4.0])
    assert fit.r == pytest.approx(0.8)  # sum of products 4, sums of squares 5 and 5
    assert fit.slope == pytest.approx(0.8)
    assert fit.intercept_m == pytest.approx(0.5)  # 2.5 - 0.8 * 2.5


def test_correlation_agrees_with_scipy() -> None:
    rng = np.random.default_rng(1)
    x = rng.uniform(1.5, 7.0, 200)
    y = x - 1.0 + rng.normal(0.0, 0.4, 200)
    fit, pearson, line = fit_line("all", x.tolist(), y.tolist()), stats.pearsonr(x, y), stats.linregress(x, y)
    interval = pearson.confidence_interval(0.95)
    assert fit.r == pytest.approx(pearson.statistic)
    assert (fit.low, fit.high) == (pytest.approx(interval.low), pytest.approx(interval.high))
    assert fit.p == pytest.approx(pearson.pvalue)
    assert (fit.slope, fit.slope_error) == (pytest.approx(line.slope), pytest.approx(line.stderr))


def test_the_fisher_interval_of_the_published_correlation_is_the_published_interval() -> None:
    rng = np.random.default_rng(2)
    x, noise = rng.normal(size=1174), rng.normal(size=1174)
    noise -= noise.mean() + (noise @ (x - x.mean())) / ((x - x.mean()) @ (x - x.mean())) * (x - x.mean())
    y = 0.94 * (x - x.mean()) / x.std() + (1 - 0.94**2) ** 0.5 * noise / noise.std()  # exactly r = 0.94
    fit = fit_line("all", x.tolist(), y.tolist())
    assert fit.r == pytest.approx(0.94)
    assert fit.low is not None
    assert fit.high is not None
    assert (round(fit.low, 2), round(fit.high, 2)) == (0.93, 0.95)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_fewer_than_three_episodes_give_a_note_instead_of_a_correlation(count: int) -> None:
    fit = fit_line("near", list(range(count)), list(range(count)))
    assert (fit.n, fit.r, fit.p, fit.slope) == (count, None, None, None)
    assert fit.remark == f"a fit needs at least 3 episodes, the group has {count}"


def test_the_interval_of_three_episodes_contains_every_possible_correlation() -> None:
    fit = fit_line("far", [1.0, 2.0, 3.0], [1.0, 3.0, 2.0])
    assert (fit.low, fit.high) == (-1.0, 1.0)


def test_equal_distances_give_a_note_instead_of_a_correlation() -> None:
    fit = fit_line("near", [2.0] * 5, [1.0, 1.1, 1.2, 1.3, 1.4])
    assert fit.r is None
    assert fit.remark == "all spawn distances are equal"


def test_a_perfect_line_has_a_finite_interval_and_can_be_written_as_json() -> None:
    fit = fit_line("near", [1.0, 2.0, 3.0, 4.0], [2.0, 4.0, 6.0, 8.0])
    assert fit.slope == pytest.approx(2.0)
    assert fit.low == pytest.approx(1.0)
    json.dumps(fit.model_dump(mode="json"), allow_nan=False)
