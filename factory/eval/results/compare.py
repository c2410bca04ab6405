"""Compares two evaluation runs over the same episodes in pairs, with intervals and a test. Pure functions."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Annotated

from pydantic import Field

from factory.eval.models.result import DIFFERENCE_BOUNDS, MEANS, EpisodeResult, Variant
from factory.eval.results.estimate import SIGNIFICANT_P, IntervalEstimate, difference_of_shares, mcnemar_p, means_of
from factory.stats.measures import share_of
from factory.stats.statistics import Share
from schemas.base import Fraction, Model
from schemas.errors import UsageError

Count = Annotated[int, Field(ge=0)]
Pair = tuple[EpisodeResult, EpisodeResult]
"""Results of one episode of two policies."""
ONE_SUCCEEDED = ((True, False), (False, True))


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
    comparisons: Annotated[int, Field(ge=1)] = 1
    """Number of comparisons that are made together."""
    corrected_p: Fraction | None = Field(default=None, exclude_if=lambda it: it is None)
    """`p` times the number of comparisons (Bonferroni); null and omitted for one comparison."""
    success_difference: IntervalEstimate
    """Difference of the success rates, a fraction; with several comparisons, all these intervals are true with 95 %."""
    differences: dict[str, IntervalEstimate]
    """Means of the paired differences with their intervals, by metric."""

    @property
    def is_significant(self) -> bool:
        """Whether equality of the success rates is rejected at 5 %, over all comparisons that are made together."""
        return (self.p if self.corrected_p is None else self.corrected_p) < SIGNIFICANT_P


def compare(
    first: Sequence[EpisodeResult], second: Sequence[EpisodeResult], variant: Variant, comparisons: int = 1
) -> PairedComparison:
    """Returns the paired comparison of two policies' results under one variant of the instruction.

    Args:
        first: results of the first policy.
        second: results of the second policy.
        variant: variant of the instruction.
        comparisons: number of comparisons that are made together, for which tests and intervals are corrected.

    Raises:
        UsageError: The runs have no common episode.
    """
    pairs = pairs_of(first, second, variant)
    left_out = len(_by_request(first, variant).keys() ^ _by_request(second, variant).keys())
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
        left_out=left_out,
        first_success=share_of(sum(a for a, _ in wins), len(pairs)),
        second_success=share_of(sum(b for _, b in wins), len(pairs)),
        both=wins.count((True, True)),
        only_first=only_first,
        only_second=only_second,
        neither=wins.count((False, False)),
        p=mcnemar_p(only_first, only_second),
        comparisons=comparisons,
        corrected_p=None if comparisons == 1 else mcnemar_p(only_first, only_second, comparisons),
        success_difference=difference_of_shares(only_first, only_second, len(pairs), comparisons),
        differences=differences,
    )


def compare_all(runs: Sequence[Sequence[EpisodeResult]], variant: Variant = Variant.ORIGINAL) -> list[PairedComparison]:
    """Returns the comparisons of each pair of policies that have common episodes, corrected for their number.

    Args:
        runs: results of each policy.
        variant: variant of the instruction.
    """
    keys = [_by_request(rows, variant).keys() for rows in runs]
    couples = [(a, b) for a, b in itertools.combinations(range(len(runs)), 2) if keys[a] & keys[b]]
    return [compare(runs[a], runs[b], variant, len(couples)) for a, b in couples]


def require_common(comparisons: list[PairedComparison], variant: Variant) -> list[PairedComparison]:
    """Returns the comparisons.

    Raises:
        UsageError: There are none.
    """
    if not comparisons:
        raise UsageError(
            f"the policies have no {variant} episode in common; evaluate all with the same --specs and --latency"
        )
    return comparisons


def pairs_of(first: Sequence[EpisodeResult], second: Sequence[EpisodeResult], variant: Variant) -> list[Pair]:
    """Returns the results of the episodes that both policies have run, in the order of the first.

    Raises:
        UsageError: There are none.
    """
    ones, others = (_by_request(rows, variant) for rows in (first, second))
    pairs = [(ones[key], others[key]) for key in ones if key in others]
    if not pairs:
        raise UsageError(
            f"the two runs have no {variant} episode in common (they have {len(ones)} and {len(others)} episodes); "
            "evaluate both with the same --specs and --latency"
        )
    return pairs


def choose_different(pairs: Sequence[Pair], count: int) -> list[Pair]:
    """Returns at most `count` pairs in which one policy succeeded; as equally as possible of each kind, in order."""
    kinds = [[pair for pair in pairs if (pair[0].success, pair[1].success) == wins] for wins in ONE_SUCCEEDED]
    few, many = sorted(kinds, key=len)
    taken = few[: count // 2] if len(many) >= count - count // 2 else few[: max(0, count - len(many))]
    chosen = {id(pair) for pair in [*taken, *many[: count - len(taken)]]}
    return [pair for pair in pairs if id(pair) in chosen]


def _by_request(rows: Sequence[EpisodeResult], variant: Variant) -> dict[tuple[str, str], EpisodeResult]:
    return {(row.spec_digest, row.instruction): row for row in rows if row.variant is variant}


def _minus(later: float | None, earlier: float | None) -> float | None:
    return None if later is None or earlier is None else later - earlier
