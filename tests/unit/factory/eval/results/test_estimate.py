"""Confidence intervals: known cases, agreement with the test beside them, equal values, and the order of values."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import stats

from factory.eval.results.estimate import SIGNIFICANT_P, difference_of_shares, mcnemar_p, mean_of, means_of
from factory.stats.measures import share_of


def test_a_mean_without_bounds_has_the_interval_of_student() -> None:
    values = np.random.default_rng(1).gamma(2.0, 1.0, 60)
    found = mean_of(values.tolist())
    reference = stats.ttest_1samp(values, 0.0).confidence_interval(0.95)
    assert (found.mean, found.low, found.high) == pytest.approx((values.mean(), reference.low, reference.high))


def test_a_mean_of_zeros_and_ones_has_the_interval_of_the_share() -> None:
    values = [1.0] * 30 + [0.0] * 70
    found, share = mean_of(values, (0.0, 1.0)), share_of(30, 100)
    assert (found.low, found.high) == pytest.approx((share.low, share.high), abs=5e-4)
    for value in (0.0, 1.0):
        found, share = mean_of([value] * 14, (0.0, 1.0)), share_of(int(14 * value), 14)
        assert (found.low, found.high) == pytest.approx((share.low, share.high))


@pytest.mark.parametrize("value", [0.0, 0.4, 1.0])
def test_equal_values_of_a_bounded_measure_have_an_interval_that_narrows(value: float) -> None:
    widths = []
    for n in (3, 10, 100, 1000):
        found = mean_of([value] * n, (0.0, 1.0))
        assert found.low is not None
        assert found.high is not None
        assert found.low <= value <= found.high
        widths.append(found.high - found.low)
    assert widths == sorted(widths, reverse=True)
    assert widths[0] > 0.4
    assert widths[-1] < 0.03


def test_values_in_another_order_have_the_same_interval() -> None:
    values = np.random.default_rng(3).random(50)
    shuffled = np.random.default_rng(4).permutation(values)
    for bounds in (None, (0.0, 1.0)):
        assert mean_of(values.tolist(), bounds) == mean_of(shuffled.tolist(), bounds)


def test_missing_values_are_omitted_and_counted() -> None:
    found = mean_of([1.0, None, 3.0, 2.0])
    assert (found.n, found.mean) == (3, 2.0)
    assert means_of({"a": [0.5, None], "b": [3.0]}, {"a": (0.0, 1.0)})["a"].n == 1


def test_values_without_spread_or_number_have_no_interval() -> None:
    assert mean_of([]).model_dump() == {"n": 0, "mean": None, "low": None, "high": None}
    assert mean_of([2.0]).model_dump() == {"n": 1, "mean": 2.0, "low": None, "high": None}
    assert mean_of([2.0, 2.0]).model_dump() == {"n": 2, "mean": 2.0, "low": None, "high": None}


def test_values_outside_the_bounds_are_an_error() -> None:
    with pytest.raises(ValueError, match=r"values from 0.5 to 1.5 are outside 0.0 to 1.0"):
        mean_of([0.5, 1.5], (0.0, 1.0))


def test_mcnemar_is_the_sign_test_of_the_discordant_pairs() -> None:
    assert mcnemar_p(0, 0) == 1.0
    assert mcnemar_p(5, 0) == pytest.approx(2 * 0.5**5)
    assert mcnemar_p(1, 3) == pytest.approx(2 * (1 + 4) / 16)


def test_the_interval_of_a_paired_difference_excludes_zero_exactly_when_the_test_rejects() -> None:
    for n, first, second in itertools.product((3, 8, 20, 60), range(13), range(13)):
        if first + second <= n:
            found, p = difference_of_shares(first, second, n), mcnemar_p(first, second)
            assert found.low is not None
            assert found.high is not None
            assert (found.low <= 0.0 <= found.high) == (p >= SIGNIFICANT_P), (n, first, second, found, p)
            assert found.mean == pytest.approx((second - first) / n)
            assert -1.0 <= found.low <= found.mean <= found.high <= 1.0
            assert found.high > found.low


def test_a_paired_difference_is_symmetric_and_its_ends_are_rejected_by_the_score_test() -> None:
    one, other = difference_of_shares(9, 24, 100), difference_of_shares(24, 9, 100)
    assert (one.low, one.high) == pytest.approx((-other.high, -other.low))
    # without discordant pairs in one direction, the score statistic of a difference d is solved by hand:
    # (x - n d)^2 = z^2 n (2 q + d (1 - d)) with q = 0, x = 0, so d = z^2 / (n + z^2)
    z2 = stats.norm.ppf(0.975) ** 2
    assert difference_of_shares(0, 0, 50).high == pytest.approx(z2 / (50 + z2))


def test_three_failures_of_the_variant_do_not_prove_a_gap() -> None:
    found = difference_of_shares(0, 3, 3)
    assert found.mean == 1.0
    assert found.low is not None
    assert found.low < 0.0
    assert mcnemar_p(0, 3) == pytest.approx(0.25)
