"""Statistical functions: means with t intervals, quantiles, Wilson intervals, Pearson correlation, Fisher intervals.

Pure functions over numbers; no I/O.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import scipy  # loads `scipy.stats` only at its first use, because that takes a second
from numpy.typing import ArrayLike, NDArray

from factory.stats.statistics import Fit, Interval, Share

CONFIDENCE = 0.95
QUANTILES = (0, 5, 25, 50, 75, 95, 100)
_FEWEST_FOR_INTERVAL = 2
_FEWEST_FOR_FIT = 3
_ALIKE = 1e-9
"""Values count as equal if their range is at most this fraction of the largest magnitude, or of 1 if that is larger."""


def mean_of(values: Sequence[float]) -> float | None:
    """Returns the arithmetic mean, or `None` for an empty sequence."""
    return float(np.mean(values)) if len(values) else None


def median_of(values: Sequence[float]) -> float | None:
    """Returns the median, or `None` for an empty sequence."""
    return float(np.median(values)) if len(values) else None


def deviation_of(values: Sequence[float]) -> float | None:
    """Returns the sample standard deviation (n - 1), or `None` for fewer than two values."""
    return float(np.std(values, ddof=1)) if len(values) > 1 else None


def interval_of(values: Sequence[float]) -> Interval | None:
    """Returns Student's t interval of the mean, or `None` for fewer than two values."""
    if len(values) < _FEWEST_FOR_INTERVAL:
        return None
    mean, half = float(np.mean(values)), float(scipy.stats.t.ppf(0.5 + CONFIDENCE / 2, len(values) - 1))
    half *= float(np.std(values, ddof=1)) / math.sqrt(len(values))
    return mean - half, mean + half


def quantiles_of(values: Sequence[float]) -> dict[str, float]:
    """Returns the quantiles in `QUANTILES` (per cent, linear interpolation), with the keys `p00`, `p05` and so on."""
    if not len(values):
        return {}
    return {f"p{level:02d}": float(np.percentile(values, level)) for level in QUANTILES}


def share_of(count: int, of: int) -> Share:
    """Returns a proportion with its Wilson score interval (Wilson, 1927); both are `None` if `of` is 0."""
    if of == 0:
        return Share(count=count, of=0, share=None, low=None, high=None)
    interval = scipy.stats.binomtest(count, of).proportion_ci(CONFIDENCE, method="wilson")
    low, high = (min(1.0, max(0.0, float(end))) for end in (interval.low, interval.high))
    return Share(count=count, of=of, share=count / of, low=low, high=high)


def fit_line(group: str, x: Sequence[float], y: Sequence[float]) -> Fit:
    """Returns Pearson's r with its Fisher z interval, and the least-squares line of y on x.

    Args:
        group: Name of the group of episodes.
        x: Spawn distances, metres.
        y: Trajectory lengths of the same episodes, metres.
    """
    if len(x) < _FEWEST_FOR_FIT:
        return _no_fit(group, len(x), f"a fit needs at least {_FEWEST_FOR_FIT} episodes, the group has {len(x)}")
    flat = [name for name, values in (("spawn distances", x), ("trajectory lengths", y)) if _is_flat(values)]
    if flat:
        return _no_fit(group, len(x), f"all {' and '.join(flat)} are equal")
    line = scipy.stats.linregress(x, y)
    low, high = _fisher_interval(float(line.rvalue), len(x))
    return Fit(
        group=group,
        n=len(x),
        r=float(line.rvalue),
        low=low,
        high=high,
        p=float(line.pvalue),
        slope=float(line.slope),
        slope_error=float(line.stderr),
        intercept_m=float(line.intercept),
    )


def _fisher_interval(r: float, n: int) -> tuple[float, float]:
    """Returns the interval by Fisher's z: atanh(r) is nearly normal with variance 1 / (n - 3) (Fisher, 1921)."""
    if abs(r) >= 1:
        return r, r
    if n <= _FEWEST_FOR_FIT:
        return -1.0, 1.0
    half = float(scipy.stats.norm.ppf(0.5 + CONFIDENCE / 2)) / np.sqrt(n - 3)
    return float(np.tanh(np.arctanh(r) - half)), float(np.tanh(np.arctanh(r) + half))


def _is_flat(values: ArrayLike) -> bool:
    array: NDArray[np.float64] = np.asarray(values, np.float64)
    return bool(np.ptp(array) <= _ALIKE * max(1.0, float(np.abs(array).max())))


def _no_fit(group: str, n: int, remark: str) -> Fit:
    return Fit(
        group=group,
        n=n,
        r=None,
        low=None,
        high=None,
        p=None,
        slope=None,
        slope_error=None,
        intercept_m=None,
        remark=remark,
    )
