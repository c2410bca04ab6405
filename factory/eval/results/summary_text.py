"""Texts of an evaluation that the page and the terminal share. Does not format shares and means. Pure functions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from factory.eval.results.estimate import IntervalEstimate
from factory.eval.results.score import PolicyScores
from factory.stats.statistics import Share


def ablation_rows(
    policies: Sequence[PolicyScores],
    share: Callable[[Share], object],
    estimate: Callable[[IntervalEstimate, int], object],
) -> Iterator[tuple[object, ...]]:
    """Yields a row for each ablation: policy, variant, episodes, n, success, gap to the original instruction, p value.

    Args:
        policies: Scores of the policies.
        share: Formats a share.
        estimate: Formats a mean with a number of digits.
    """
    for policy in policies:
        for row in policy.ablation:
            which = "all" if row.by == "all" else "2+ categories in view"
            spelt = share(row.success), estimate(row.gap, 3), f"{row.p:.3g}"
            yield policy.policy, row.variant, which, row.n, *spelt


def policies_without_instruction(policies: Sequence[PolicyScores]) -> list[str]:
    """Returns the names of policies that do not use the instruction, so their gap is 0 by construction."""
    return [policy.policy for policy in policies if not policy.reads_instruction]


def describe_ends(policy: PolicyScores) -> str:
    """Returns a description of the episode ends of a policy, and its mean inference time."""
    ends = ", ".join(f"{count} {end}" for end, count in policy.ends.items())
    return ends if policy.act_ms is None else f"{ends}; {policy.act_ms:.1f} ms per action"


def fault_lines(policy: PolicyScores) -> list[str]:
    """Returns a line for each kind of policy failure, with its first message."""
    return [
        f"{policy.policy}: {fault.drives} of {fault.of} episodes ended with {fault.end}, first {fault.first}: "
        f"{fault.detail}"
        for fault in policy.faults
    ]
