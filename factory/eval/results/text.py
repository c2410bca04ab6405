"""Prints an evaluation, or a comparison of two policies, as tables on stdout. Computes nothing."""

from __future__ import annotations

from collections.abc import Sequence

import click

from factory.eval.results.compare import PairedComparison
from factory.eval.results.estimate import IntervalEstimate
from factory.eval.results.score import GROUPS, Evaluation, PolicyScores, Score, side_by_side
from factory.eval.results.summary_text import (
    ABLATION_HEAD,
    ASSUMED,
    FAILURES,
    INTERVALS,
    ablation_rows,
    conclusion,
    describe_ends,
    failure_kinds,
    failure_rows,
    fault_lines,
    policies_without_instruction,
)
from factory.html.measures import TITLES, definitions_of
from factory.stats.statistics import Share
from factory.support.terminal import print_table, print_text

_WIDTH = 80
"""Width of the tables without a terminal, too, characters; wider tables are printed in pieces."""
_MEANS = ("spl", "ne_m", "soft_spl", "progress_max")
_HEAD = (
    *("n", "SR, %", "oracle success, %"),
    *(TITLES[name] for name in _MEANS),
    *("any instance, %", "collision, %", "timeout, %", "policy failure, %"),
)
_ALWAYS = {"split", "view"}


def print_evaluation(evaluation: Evaluation, all_tables: bool = False) -> None:
    """Prints the measures of all policies, overall, by group, and with other instructions.

    Args:
        evaluation: the evaluation.
        all_tables: also print tables by scene, tier, category and template.
    """
    print_text(
        f"{evaluation.episodes} episodes: {evaluation.source}; "
        f"success radius {evaluation.success_radius_m:g} m by {evaluation.success}"
    )
    if evaluation.limits is not None:
        print_text(f"limits: {evaluation.limits.describe()}")
    rows = [(policy.policy, *_cells(policy.overall)) for policy in evaluation.policies]
    print_table("\nAll episodes", ("policy", *_HEAD), rows, widest=_WIDTH)
    kinds = failure_kinds(evaluation.policies)
    if kinds:
        failures = [(name, *map(_plain, shares)) for name, shares in failure_rows(evaluation.policies)]
        print_table(f"\n{FAILURES}", ("policy", *kinds), failures, widest=_WIDTH)
    for by, title in GROUPS.items():
        if all_tables or by in _ALWAYS:
            _print_groups(evaluation.policies, by, title)
    _print_ablations(evaluation.policies)
    click.echo("")
    for policy in evaluation.policies:
        print_text(f"{policy.policy}: {policy.described}; {describe_ends(policy)}")
        for line in fault_lines(policy):
            print_text(line)
    for comparison in evaluation.comparisons:
        print_text(conclusion(comparison))
    if evaluation.comparisons:
        print_text(ASSUMED)
    for remark in evaluation.remarks:
        print_text(f"note: {remark}")
    print_text(INTERVALS)
    for name, definition in definitions_of(_HEAD).items():
        print_text(f"{name}: {definition}")


def print_comparison(comparison: PairedComparison) -> None:
    """Prints a paired comparison."""
    one, other = comparison.first, comparison.second
    print_text(f"{comparison.pairs} episodes run by both policies ({comparison.variant} instruction)")
    print_text(conclusion(comparison))
    rows = [(one, _share(comparison.first_success)), (other, _share(comparison.second_success))]
    print_table("", ("policy", "SR, %"), rows, widest=_WIDTH)
    counts = f"both {comparison.both}, only {one} {comparison.only_first}, only {other} {comparison.only_second}"
    print_text(f"\nsucceeded: {counts}, neither {comparison.neither}; exact McNemar p = {comparison.p:.3g}")
    if comparison.corrected_p is not None:
        print_text(f"corrected for {comparison.comparisons} comparisons (Bonferroni): p = {comparison.corrected_p:.3g}")
    body = [("SR, points", _points(comparison.success_difference))]
    body += [(TITLES[name], _estimate(value, 3)) for name, value in comparison.differences.items()]
    print_table(f"\n{other} minus {one}", ("measure", "mean, 95 % interval"), body, widest=_WIDTH)
    if comparison.left_out:
        print_text(f"not compared: {comparison.left_out} episodes run by one policy only")


def _print_groups(policies: Sequence[PolicyScores], by: str, title: str) -> None:
    rows = [(name, policy.policy, *_cells(group)) for name, policy, group in side_by_side(policies, by)]
    if rows:
        print_table(f"\n{title}", (by, "policy", *_HEAD), rows, widest=_WIDTH)


def _print_ablations(policies: Sequence[PolicyScores]) -> None:
    rows = list(ablation_rows(policies, _share, _points))
    if rows:
        print_table("\nInstruction ablation", ("policy", *ABLATION_HEAD), rows, widest=_WIDTH)
        for name in policies_without_instruction(policies):
            print_text(f"{name}: does not use the instruction, difference 0 by construction")


def _cells(score: Score) -> tuple[object, ...]:
    return (
        score.n,
        _share(score.success),
        _share(score.oracle_success),
        *(_estimate(getattr(score, name)) for name in _MEANS),
        _share(score.any_instance),
        _plain(score.collision),
        _plain(score.timeout),
        _plain(score.policy_failure),
    )


def _share(share: Share) -> str:
    if share.share is None or share.low is None or share.high is None:
        return "-"
    return f"{100 * share.share:.1f} [{100 * share.low:.0f}, {100 * share.high:.0f}]"


def _plain(share: Share) -> str:
    return "-" if share.share is None else f"{100 * share.share:.1f}"


def _points(value: IntervalEstimate) -> str:
    """Returns a difference of shares in percentage points."""
    if value.mean is None or value.low is None or value.high is None:
        return "-"
    return f"{100 * value.mean:+.1f} [{100 * value.low:+.0f}, {100 * value.high:+.0f}]"


def _estimate(value: IntervalEstimate, digits: int = 2) -> str:
    if value.mean is None:
        return "-"
    if value.low is None or value.high is None:
        return f"{value.mean:.{digits}f}"
    return f"{value.mean:.{digits}f} [{value.low:.{digits}f}, {value.high:.{digits}f}]"
