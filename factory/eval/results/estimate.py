"""Estimates with 95 % intervals: means, paired differences of shares, and the exact McNemar test. Pure functions.

The intervals have a width for equal values and for few episodes, agree with the test beside them, and do not depend on
the order of the values (docs/evaluation/README.md#intervals).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
import scipy  # imports `scipy.stats` at its first use, which takes a second
from pydantic import Field

from schemas.base import Model

CONFIDENCE = 0.95
FEW = 20
"""With fewer episodes than this, tables have a warning."""
_PRIOR = 2.0
"""Number of values by which the variance of a bounded measure is drawn to the largest that its mean permits."""
# with 2, the simulated coverage of SPL, soft-SPL, progress and their paired differences is at least 95 % on average for
# 3 to 200 episodes (tests/unit/factory/eval/results/test_coverage.py); with 0, it is 83 % for 3 episodes
_STEPS = 60
"""Number of bisections, which find an end of an interval to 1e-18."""
SIGNIFICANT_P = 1.0 - CONFIDENCE
POWER = 0.8
"""Probability with which a difference shall be found."""
DIFFER = 0.2
"""Assumed share of the episodes in which two policies end differently."""
MOST_PAIRS = 100_000
"""Largest number of episodes that is searched for a difference."""

Bounds = tuple[float, float]


class IntervalEstimate(Model):
    """Mean with its 95 % interval."""

    n: Annotated[int, Field(ge=0)]
    mean: float | None
    """Mean; `None` without values."""
    low: float | None
    high: float | None
    """`low` and `high` are the ends of the interval; `None` for fewer than two values, and for equal values of a
    measure without bounds, about whose spread they say nothing."""

    def above(self, least: float) -> IntervalEstimate:
        """Returns the estimate with an interval that does not extend below the least possible value."""
        return self if self.low is None else self.model_copy(update={"low": max(self.low, least)})


NO_VALUES = IntervalEstimate(n=0, mean=None, low=None, high=None)


def mean_of(values: Sequence[float | None], bounds: Bounds | None = None) -> IntervalEstimate:
    """Returns the mean of the values that are not `None`, with its interval.

    A measure with bounds has Wilson's score interval (E. B. Wilson, 1927) for an effective number of values: n over the
    ratio of its variance to the largest variance with this mean, as for shares in surveys (E. L. Korn and B. I.
    Graubard, 1998). For values of 0 and 1 it is Wilson's interval. Other measures have Student's t interval.

    Args:
        values: values in any order.
        bounds: smallest and largest possible value, the largest may be infinite; `None` for a measure without bounds.
    """
    present = sorted(value for value in values if value is not None)
    n = len(present)
    if n == 0:
        return NO_VALUES
    mean = math.fsum(present) / n
    if n == 1:
        return IntervalEstimate(n=n, mean=mean, low=None, high=None)
    variance = math.fsum((value - mean) ** 2 for value in present) / (n - 1)
    if bounds is None:
        if present[0] == present[-1]:
            return IntervalEstimate(n=n, mean=present[0], low=None, high=None)
        return _student(n, mean, variance)
    low, high = bounds
    if math.isinf(high):
        return mean_of(present).above(low)
    if not low <= present[0] <= present[-1] <= high:
        raise ValueError(f"values from {present[0]} to {present[-1]} are outside {low} to {high}")
    share = min(max((mean - low) / (high - low), 0.0), 1.0)
    largest = share * (1.0 - share)
    ratio = min(1.0, variance / (high - low) ** 2 / largest) if largest > 0.0 else 1.0
    ends = _wilson(share, n * (n + _PRIOR) / (n * ratio + _PRIOR))
    return IntervalEstimate(n=n, mean=mean, low=low + (high - low) * ends[0], high=low + (high - low) * ends[1])


def _student(n: int, mean: float, variance: float) -> IntervalEstimate:
    half = float(scipy.stats.t.ppf(0.5 + CONFIDENCE / 2, n - 1)) * math.sqrt(variance / n)
    return IntervalEstimate(n=n, mean=mean, low=mean - half, high=mean + half)


def _wilson(share: float, n: float) -> tuple[float, float]:
    """Returns Wilson's score interval of a share of `n` trials; `n` need not be an integer."""
    z = float(scipy.stats.norm.ppf(0.5 + CONFIDENCE / 2))
    centre = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    return min(share, max(0.0, centre - half)), max(share, min(1.0, centre + half))


def means_of(
    columns: Mapping[str, Sequence[float | None]], bounds: Mapping[str, Bounds] | None = None
) -> dict[str, IntervalEstimate]:
    """Returns the means of several measures; `bounds` has the bounds of those that have any."""
    known = bounds or {}
    return {name: mean_of(column, known.get(name)) for name, column in columns.items()}


def difference_of_shares(only_first: int, only_second: int, pairs: int, comparisons: int = 1) -> IntervalEstimate:
    """Returns the share of successes of the second run minus that of the first, over the same episodes.

    The interval is the score interval of T. Tango (1998). It is extended to 0 if the exact McNemar test does not reject
    equality, so test and interval agree; the exact test rejects less often than the score test.

    Args:
        only_first: number of pairs in which only the first run succeeded.
        only_second: number of pairs in which only the second run succeeded.
        pairs: number of pairs.
        comparisons: number of comparisons whose intervals shall all be true with 95 % (Bonferroni).
    """
    if pairs == 0:
        return NO_VALUES
    mean = (only_second - only_first) / pairs
    z = float(scipy.stats.norm.isf(SIGNIFICANT_P / comparisons / 2))
    low = -_tango_end(only_first, only_second, pairs, z)
    high = _tango_end(only_second, only_first, pairs, z)
    if mcnemar_p(only_first, only_second, comparisons) >= SIGNIFICANT_P:
        low, high = min(low, 0.0), max(high, 0.0)
    return IntervalEstimate(n=pairs, mean=mean, low=low, high=high)


def _tango_end(more: int, less: int, pairs: int, z: float) -> float:
    """Returns the upper end of Tango's interval of the difference (more - less) / pairs."""
    low, high = (more - less) / pairs, 1.0
    for _ in range(_STEPS):
        middle = (low + high) / 2
        low, high = (middle, high) if _tango_z(more, less, pairs, middle) > -z else (low, middle)
    return high


def _tango_z(more: int, less: int, pairs: int, difference: float) -> float:
    """Returns the score statistic of a difference (T. Tango, 1998, equations 3 and 4)."""
    b = -more - less + (2 * pairs - more + less) * difference
    c = -less * difference * (1 - difference)
    least = (math.sqrt(max(b * b - 8 * pairs * c, 0.0)) - b) / (4 * pairs)
    variance = pairs * (2 * least + difference * (1 - difference))
    distance = more - less - pairs * difference
    return (
        math.copysign(math.inf, distance)
        if variance <= 0.0 and distance
        else distance / math.sqrt(max(variance, 1e-300))
    )


def mcnemar_p(only_first: int, only_second: int, comparisons: int = 1) -> float:
    """Returns the two-sided p of the exact McNemar test (Q. McNemar, 1947), times the number of comparisons.

    Args:
        only_first: Number of pairs in which only the first run succeeded.
        only_second: Number of pairs in which only the second run succeeded.
        comparisons: Number of comparisons that are made (Bonferroni).
    """
    discordant = only_first + only_second
    if discordant == 0:
        return 1.0
    return min(1.0, comparisons * float(scipy.stats.binomtest(only_first, discordant, 0.5).pvalue))


def power(pairs: int, difference: float, comparisons: int = 1, differ: float = DIFFER) -> float:
    """Returns the probability that the exact McNemar test rejects equality of two policies.

    Args:
        pairs: number of episodes that both policies run.
        difference: true difference of the success rates, a fraction.
        comparisons: number of comparisons that are made (Bonferroni).
        differ: share of the episodes that exactly one of the policies succeeds in; at least `difference`.
    """
    differ = max(differ, difference)
    half = 8.0 * math.sqrt(pairs * differ * (1.0 - differ)) + 1.0  # beyond it is less than 1e-14
    counts = np.arange(max(0, int(pairs * differ - half)), min(pairs, int(pairs * differ + half)) + 1)
    likely = scipy.stats.binom.pmf(counts, pairs, differ)
    # the most successes of the worse policy for which the test rejects; -1 if it rejects for no count
    most = scipy.stats.binom.ppf(SIGNIFICANT_P / comparisons / 2, counts, 0.5)
    most -= scipy.stats.binom.cdf(most, counts, 0.5) * 2 * comparisons >= SIGNIFICANT_P
    worse = 0.5 - difference / differ / 2
    rejects = scipy.stats.binom.cdf(most, counts, worse) + scipy.stats.binom.cdf(most, counts, 1.0 - worse)
    return float(likely @ rejects)


def resolved_difference(pairs: int, comparisons: int = 1, differ: float = DIFFER) -> float | None:
    """Returns the smallest difference of two success rates with a power of 80 %; `None` if there is none.

    Args:
        pairs: number of episodes that both policies run.
        comparisons: number of comparisons that are made (Bonferroni).
        differ: share of the episodes that exactly one of the policies succeeds in.
    """
    low, high = 0.0, 1.0
    if power(pairs, high, comparisons, differ) < POWER:
        return None
    while high - low > 1e-4:
        middle = (low + high) / 2
        low, high = (low, middle) if power(pairs, middle, comparisons, differ) >= POWER else (middle, high)
    return high


def needed_pairs(difference: float, comparisons: int = 1, differ: float = DIFFER) -> int | None:
    """Returns the number of episodes that resolve a difference; `None` if it is more than 100,000.

    The power of an exact test does not increase with each episode, so a few episodes fewer can have it, too.

    Args:
        difference: true difference of the success rates, a fraction.
        comparisons: number of comparisons that are made (Bonferroni).
        differ: share of the episodes that exactly one of the policies succeeds in.
    """
    low, high = 0, MOST_PAIRS
    if power(high, difference, comparisons, differ) < POWER:
        return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if power(middle, difference, comparisons, differ) >= POWER else (middle, high)
    return high
