"""Model of the comparison of one number with the paper, for the page, `report.json` and `--json`. Data only."""

from __future__ import annotations

from typing import Literal

from factory.stats.statistics import Interval
from schemas.base import Model

Verdict = Literal["inside", "outside", "undecided"]
"""Position of a 95 % interval relative to a target: wholly inside, wholly outside, or partly inside."""


class PaperComparison(Model):
    """Comparison of one number that is computed from the dataset with the paper."""

    exhibit: str
    """Name of the figure."""
    what: str
    ours: float | None
    """Number computed from the dataset; `None` without data."""
    published: float
    published_high: float | None = None
    """Upper bound, if the paper gives a range."""
    interval: Interval | None = None
    """95 % interval of `ours`; `None` if the number has no interval or there are too few episodes."""
    target: Interval | None = None
    """Smallest and largest number that agree with the paper."""
    verdict: Verdict | None = None
    """Position of the interval relative to the target; `None` without an interval or a target."""
    unit: str
    """Unit: `m`, `steps`, `share`, or empty for a plain number."""
    digits: int
    source: str
    reason: str = ""
    """Reason for the difference, with numbers; empty if the difference is below the threshold."""

    @property
    def difference(self) -> float | None:
        """`ours` minus `published`; for a published range, minus its nearer bound, or 0 if `ours` is in the range."""
        if self.ours is None:
            return None
        high = self.published if self.published_high is None else self.published_high
        return self.ours - min(max(self.ours, self.published), high)

    @property
    def ratio(self) -> float | None:
        """`ours` divided by `published`; `None` if the paper gives a range or 0."""
        if self.ours is None or self.published_high is not None or self.published == 0:
            return None
        return self.ours / self.published


def verdict_of(interval: Interval | None, target: Interval | None) -> Verdict | None:
    """Returns the position of an interval relative to a target, or `None` if either is missing."""
    if interval is None or target is None:
        return None
    # a small run can meet or miss a published number by chance, so its point estimate decides nothing
    if interval[1] < target[0] or target[1] < interval[0]:
        return "outside"
    return "inside" if target[0] <= interval[0] and interval[1] <= target[1] else "undecided"
