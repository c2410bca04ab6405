"""What page and terminal say alike about an evaluation; how a share or a mean is spelt is theirs. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from factory.eval.results.estimate import IntervalEstimate
from factory.eval.results.score import PolicyScores
from factory.stats.model import Share

__all__ = ["ablation_rows", "deaf_policies", "ends_of", "faults_in_words"]


def ablation_rows(
    policies: Sequence[PolicyScores],
    share: Callable[[Share], object],
    estimate: Callable[[IntervalEstimate, int], object],
) -> Iterator[tuple[object, ...]]:
    """Yields policy, words, episodes, n, success, gap to the true words and McNemar's p, for each set of other words.

    Args:
        policies: in order.
        share: spells a share.
        estimate: spells a mean with so many digits.
    """
    for policy in policies:
        for row in policy.ablation:
            which = "all" if row.by == "all" else "2+ categories in view"
            spelt = share(row.success), estimate(row.gap, 3), f"{row.p:.3g}"
            yield policy.policy, row.variant, which, row.n, *spelt


def deaf_policies(policies: Sequence[PolicyScores]) -> list[str]:
    """Returns those that read no instruction, so that their gap is 0 by construction."""
    return [policy.policy for policy in policies if not policy.reads_instruction]


def ends_of(policy: PolicyScores) -> str:
    """Returns how the episodes of a policy ended, and how long it thought."""
    ends = ", ".join(f"{count} {end}" for end, count in policy.ends.items())
    return ends if policy.act_ms is None else f"{ends}; {policy.act_ms:.1f} ms per action"


def faults_in_words(policy: PolicyScores) -> list[str]:
    """Returns a line for each way in which a policy failed as a program, with what it said first."""
    return [
        f"{policy.policy}: {fault.drives} of {fault.of} episodes ended with {fault.end}, first {fault.first}: "
        f"{fault.detail}"
        for fault in policy.faults
    ]
