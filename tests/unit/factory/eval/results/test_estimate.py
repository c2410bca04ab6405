"""Confidence intervals: compared with scipy, on degenerate data, and repeatable."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from factory.eval.results.estimate import mcnemar_p, mean_of, means_of


def test_an_interval_agrees_with_the_bca_bootstrap_of_scipy() -> None:
    values = np.random.default_rng(1).gamma(2.0, 1.0, 60)
    found = mean_of(values.tolist())
    reference = stats.bootstrap(
        (values,), np.mean, n_resamples=20_000, method="BCa", rng=np.random.default_rng(5)
    ).confidence_interval
    assert found.mean == pytest.approx(values.mean())
    assert found.low == pytest.approx(reference.low, abs=0.05)
    assert found.high == pytest.approx(reference.high, abs=0.05)
    assert found.low is not None
    assert found.high is not None
    assert found.high - found.mean > found.mean - found.low  # the data are skewed to the right, and BCa corrects for it


def test_an_interval_has_about_its_nominal_coverage() -> None:
    rng = np.random.default_rng(7)
    samples = [rng.normal(3.0, 1.0, 40).tolist() for _ in range(120)]
    found = [mean_of(sample) for sample in samples]
    covered = sum(e.low is not None and e.high is not None and e.low <= 3.0 <= e.high for e in found)
    assert 104 <= covered <= 120


def test_the_same_values_give_the_same_interval_alone_or_beside_others() -> None:
    values = [0.1, 0.5, 0.7, 0.2, 0.9]
    assert means_of({"a": values, "b": [1.0, 2.0, 3.0, 4.0, 9.0]})["a"] == mean_of(values)


def test_missing_values_are_omitted_and_counted() -> None:
    found = mean_of([1.0, None, 3.0, 2.0])
    assert (found.n, found.mean) == (3, 2.0)


def test_degenerate_data_have_a_point_or_no_interval() -> None:
    assert mean_of([]).model_dump() == {"n": 0, "mean": None, "low": None, "high": None}
    assert mean_of([2.0]).model_dump() == {"n": 1, "mean": 2.0, "low": None, "high": None}
    assert mean_of([2.0, 2.0]).model_dump() == {"n": 2, "mean": 2.0, "low": 2.0, "high": 2.0}


def test_mcnemar_is_the_sign_test_of_the_discordant_pairs() -> None:
    assert mcnemar_p(0, 0) == 1.0
    assert mcnemar_p(5, 0) == pytest.approx(2 * 0.5**5)
    assert mcnemar_p(1, 3) == pytest.approx(2 * (1 + 4) / 16)
