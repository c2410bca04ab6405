"""Estimates with 95 % intervals: BCa bootstrap for means; exact McNemar test for pairs. Pure functions, fixed seed."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
import scipy  # imports `scipy.stats` at its first use, which takes a second
from numpy.typing import NDArray
from pydantic import Field

from schemas.base import Model

CONFIDENCE = 0.95
RESAMPLES = 2000
_SEED = 20180718
_BATCH = 250


class IntervalEstimate(Model):
    """Mean with its bias-corrected and accelerated bootstrap interval (B. Efron, 1987)."""

    n: Annotated[int, Field(ge=0)]
    mean: float | None
    """Mean; `None` without values."""
    low: float | None
    high: float | None
    """`low` and `high` are the ends of the interval; `None` for fewer than two values, or if BCa is not defined."""


NO_VALUES = IntervalEstimate(n=0, mean=None, low=None, high=None)


def mean_of(values: Sequence[float | None]) -> IntervalEstimate:
    """Returns the mean of the values that are not `None`, with its interval; deterministic."""
    return means_of({"": values})[""]


def means_of(columns: Mapping[str, Sequence[float | None]]) -> dict[str, IntervalEstimate]:
    """Returns the means of several columns of the same rows; resamples the columns together, which is faster."""
    means: dict[str, IntervalEstimate] = {}
    full: dict[str, NDArray[np.float64]] = {}
    for name, column in columns.items():
        values = np.array([value for value in column if value is not None], np.float64)
        if len(values) < 2 or np.ptp(values) == 0:
            means[name] = _certain(values)
        elif len(values) < len(column):
            means[name] = _resampled({name: values})[name]
        else:
            full[name] = values
    if full:
        means |= _resampled(full)
    return {name: means[name] for name in columns}


def mcnemar_p(only_first: int, only_second: int) -> float:
    """Returns the two-sided p of the exact McNemar test (Q. McNemar, 1947).

    Args:
        only_first: Number of pairs in which only the first run succeeded.
        only_second: Number of pairs in which only the second run succeeded.
    """
    discordant = only_first + only_second
    return 1.0 if discordant == 0 else float(scipy.stats.binomtest(only_first, discordant, 0.5).pvalue)


def _certain(values: NDArray[np.float64]) -> IntervalEstimate:
    """Returns the estimate of equal values: both ends of the interval are this value; one value has no interval."""
    if len(values) == 0:
        return NO_VALUES
    mean = float(values[0])
    ends = mean if len(values) > 1 else None
    return IntervalEstimate(n=len(values), mean=mean, low=ends, high=ends)


def _resampled(columns: Mapping[str, NDArray[np.float64]]) -> dict[str, IntervalEstimate]:
    data = np.stack(list(columns.values()))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", scipy.stats.DegenerateDataWarning)  # the result is NaN, which becomes None
        interval = scipy.stats.bootstrap(
            (data,),
            np.mean,
            axis=-1,
            n_resamples=RESAMPLES,
            batch=_BATCH,
            confidence_level=CONFIDENCE,
            method="BCa",
            rng=np.random.default_rng(_SEED),
        ).confidence_interval
    return {
        name: IntervalEstimate(n=len(values), mean=float(values.mean()), low=_finite(low), high=_finite(high))
        for (name, values), low, high in zip(columns.items(), interval.low, interval.high, strict=True)
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
