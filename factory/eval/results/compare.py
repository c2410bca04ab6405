"""Compares two evaluation runs over the same episodes in pairs, with intervals and a test. Pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from pydantic import Field

from factory.eval.models.result import EpisodeResult, Variant
from factory.eval.results.estimate import IntervalEstimate, difference_of_shares, mcnemar_p, means_of
from factory.eval.results.score import DIFFERENCE_BOUNDS, MEANS
from factory.stats.measures import share_of
from factory.stats.statistics import Share
from schemas.base import Fraction, Model
from schemas.errors import UsageError

Count = Annotated[int, Field(ge=0)]


class PairedComparison(Model):
    """Paired comparison of two runs; differences are second minus first."""

    first: str
    second: str
    variant: Variant
    pairs: Count
    """Number of common episodes, with equal start, target, settings and instruction."""
    left_out: Count
    """Number of episodes in only one of the runs."""
    first_success: Share
    second_success: Share
    both: Count
    only_first: Count
    only_second: Count
    neither: Count
    p: Fraction
    """Two-sided p value of the exact McNemar test."""
    success_difference: IntervalEstimate
    differences: dict[str, IntervalEstimate]
    """Means of the paired differences with their intervals, by metric."""


def compare(first: Sequence[EpisodeResult], second: Sequence[EpisodeResult], variant: Variant) -> PairedComparison:
    """Returns the paired comparison of two policies' results under one variant of the instruction.

    Raises:
        UsageError: The runs have no common episode.
    """
    ones, others = (_by_request(rows, variant) for rows in (first, second))
    common = [key for key in ones if key in others]
    if not common:
        raise UsageError(
            f"the two runs have no {variant} episode in common (they have {len(ones)} and {len(others)} episodes); "
            "evaluate both with the same --specs"
        )
    pairs = [(ones[key], others[key]) for key in common]
    wins = [(one.success, other.success) for one, other in pairs]
    only_first, only_second = wins.count((True, False)), wins.count((False, True))
    differences = means_of(
        {name: [_minus(getattr(b, field), getattr(a, field)) for a, b in pairs] for name, field in MEANS.items()},
        DIFFERENCE_BOUNDS,
    )
    return PairedComparison(
        first=pairs[0][0].policy,
        second=pairs[0][1].policy,
        variant=variant,
        pairs=len(pairs),
        left_out=len(ones) + len(others) - 2 * len(pairs),
        first_success=share_of(sum(a for a, _ in wins), len(pairs)),
        second_success=share_of(sum(b for _, b in wins), len(pairs)),
        both=wins.count((True, True)),
        only_first=only_first,
        only_second=only_second,
        neither=wins.count((False, False)),
        p=mcnemar_p(only_first, only_second),
        success_difference=difference_of_shares(only_first, only_second, len(pairs)),
        differences=differences,
    )


def _by_request(rows: Sequence[EpisodeResult], variant: Variant) -> dict[tuple[str, str], EpisodeResult]:
    return {(row.spec_digest, row.instruction): row for row in rows if row.variant is variant}


def _minus(later: float | None, earlier: float | None) -> float | None:
    return None if later is None or earlier is None else later - earlier
