"""Texts of an evaluation that the page and the terminal share. Does not format shares and means. Pure functions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

from factory.eval.models.result import EvalEnd, FailureKind
from factory.eval.policies.made_from import describe
from factory.eval.results.compare import PairedComparison
from factory.eval.results.estimate import DIFFER, POWER, IntervalEstimate, resolved_difference
from factory.eval.results.score import PolicyScores
from factory.stats.measures import share_of
from factory.stats.statistics import Share

_MOST_CLIPPED = 0.05
_LEAST_P = 1e-4
"""Smallest p value that is printed as a number."""
_DIGITS = 12
"""Hexadecimal digits of a digest in a text."""
INTERVALS = (
    "95 % intervals: shares by Wilson, measures from 0 to 1 by Wilson with an effective number of episodes, other "
    "means by Student's t, paired differences of SR by Tango"
)
ABLATION_HEAD = ("instruction", "episodes", "n", "SR, %", "SR minus SR of the original, points", "McNemar p")
"""Head of the columns of `ablation_rows` after the policy."""


def ablation_rows(
    policies: Sequence[PolicyScores],
    share: Callable[[Share], object],
    points: Callable[[IntervalEstimate], object],
) -> Iterator[tuple[object, ...]]:
    """Yields a row for each ablation: policy, variant, episodes, n, success, difference to the original, p value.

    Args:
        policies: Scores of the policies.
        share: Formats a share.
        points: Formats a difference of shares in percentage points.
    """
    for policy in policies:
        for row in policy.ablation:
            which = "all" if row.by == "all" else "2+ categories in view"
            spelt = share(row.success), points(row.difference), f"{row.p:.3g}"
            yield policy.policy, row.variant, which, row.n, *spelt


def conclusion(comparison: PairedComparison) -> str:
    """Returns a sentence with what a comparison shows, its interval and its test."""
    first, second, value = comparison.first, comparison.second, comparison.success_difference
    mean, low, high = value.mean or 0.0, value.low or 0.0, value.high or 0.0
    p = comparison.p if comparison.corrected_p is None else comparison.corrected_p
    test = f"p = {p:.2g}" if p >= _LEAST_P else f"p < {_LEAST_P:g}"
    if comparison.comparisons > 1:
        test += f", corrected for {comparison.comparisons} comparisons"
    counted = f"in {_episodes(comparison.pairs)}"
    if comparison.is_significant:
        better, worse = (second, first) if mean > 0 else (first, second)
        ends = sorted((abs(100 * low), abs(100 * high)))
        points = f"{abs(100 * mean):.1f} points [{ends[0]:.1f}, {ends[1]:.1f}]"
        return f"{better} succeeds more often than {worse}: by {points} {counted} ({test})"
    points = f"{100 * mean:+.1f} points [{100 * low:+.1f}, {100 * high:+.1f}]"
    return (
        f"No difference between {first} and {second} is shown {counted}: {points} ({test}); "
        f"{resolution(comparison.pairs, comparison.comparisons)}"
    )


def resolution(pairs: int, comparisons: int = 1) -> str:
    """Returns a sentence with the difference of two success rates that a number of episodes resolves."""
    least = resolved_difference(pairs, comparisons)
    if least is None:
        return f"{_episodes(pairs)} resolve no difference"
    return f"{_episodes(pairs)} resolve {math.ceil(100 * least)} points"


def _episodes(count: int) -> str:
    return f"{count} episode{'' if count == 1 else 's'}"


ASSUMED = (
    f"A difference is resolved if it is found with a probability of {100 * POWER:.0f} %, provided that the policies "
    f"end differently in {100 * DIFFER:.0f} % of the episodes"
)


def policies_without_instruction(policies: Sequence[PolicyScores]) -> list[str]:
    """Returns the names of policies that do not use the instruction, so their gap is 0 by construction."""
    return [policy.policy for policy in policies if not policy.reads_instruction]


FAILURES = "Failures by kind, % of the episodes"


def failure_kinds(policies: Sequence[PolicyScores]) -> list[FailureKind]:
    """Returns the kinds of failure that occurred with any policy."""
    return [kind for kind in FailureKind if any(kind in policy.failures for policy in policies)]


def failure_rows(policies: Sequence[PolicyScores]) -> list[tuple[str, list[Share]]]:
    """Returns each policy with the shares of `failure_kinds`."""
    kinds = failure_kinds(policies)
    return [
        (policy.policy, [policy.failures.get(kind, share_of(0, policy.overall.n)) for kind in kinds])
        for policy in policies
    ]


def describe_ends(policy: PolicyScores) -> str:
    """Returns the ends of the episodes of a policy, its clipped actions, its hashes and its mean inference time."""
    # results of older versions have no kinds of failure
    kinds = {str(kind): share.count for kind, share in policy.failures.items()}
    others = kinds or {str(end): count for end, count in policy.ends.items() if end is not EvalEnd.SUCCESS}
    counts = {str(EvalEnd.SUCCESS): policy.ends.get(EvalEnd.SUCCESS, 0)} | others
    parts = [", ".join(f"{count} {name}" for name, count in counts.items() if count)]
    if policy.overall.clipped is not None:
        parts.append(f"{100 * policy.overall.clipped:.1f} % of the actions clipped")
    if policy.made_from:
        parts.append(describe(policy.made_from))
    if policy.training is not None and policy.training.trained_on == 0:
        parts.append(describe_training(policy))
    if policy.act_ms is not None:
        parts.append(f"{policy.act_ms:.1f} ms per action")
    return "; ".join(parts)


def describe_training(policy: PolicyScores) -> str:
    """Returns how training and evaluation of a policy overlap; empty if its training is not known."""
    training = policy.training
    if training is None:
        return ""
    digests = f"training digest {training.train_digest[:_DIGITS]}"
    if training.evaluation_digest is not None:
        digests += f", evaluation digest {training.evaluation_digest[:_DIGITS]}"
    if training.trained_on is None:
        return f"trained on unknown episodes, perhaps on evaluated ones ({digests}); train it again to record them"
    which = f"{training.trained_on or 'none'} of the {training.episodes} evaluated episodes ({digests})"
    return f"trained on {which}"


def fault_lines(policy: PolicyScores) -> list[str]:
    """Returns a line for each kind of policy failure, with its first message, and the warnings of a policy.

    Warnings are an overlap of training and evaluation, and many clipped actions.
    """
    lines = [f"{policy.policy}: not evaluated, because it failed in every episode"] if policy.only_failed else []
    lines += [
        f"{policy.policy}: {fault.drives} of {fault.of} episodes ended with {fault.end}, first {fault.first}: "
        f"{fault.detail}"
        for fault in policy.faults
    ]
    if policy.training is not None and policy.training.trained_on != 0:
        lines.append(f"{policy.policy}: warning: {describe_training(policy)}; its measures do not show generalisation")
    clipped = policy.overall.clipped
    if clipped is not None and clipped > _MOST_CLIPPED:
        lines.append(
            f"{policy.policy}: {100 * clipped:.0f} % of the actions were outside the range of the robot and were "
            "clipped; an action is v in m/s and w in rad/s: cm/s would be 100 times and degrees/s 57 times too large"
        )
    return lines
