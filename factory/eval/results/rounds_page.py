"""Page of `factory train rounds`: success rate and failures of the policy of each round.

Needs matplotlib, which the extra `train` contains.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import cycle
from typing import Any

from factory.eval.results.page import MeasureTable, failure_table, main_table
from factory.eval.results.score import Evaluation, PolicyScores
from factory.eval.results.summary_text import INTERVALS, conclusion, failure_kinds
from factory.html import render
from factory.html.palette import colour
from factory.report.drawing.canvas import Axes, Panel, count_whole, draw_panel, write_legend

_COLOURS = ("scene1", "scene2", "scene3", "scene4", "scene5", "scene6")
_DASHES = ("-", "--", ":", "-.")


def write_rounds_page(title: str, evaluation: Evaluation, links: Sequence[tuple[str, str]]) -> str:
    """Returns the page of all rounds as HTML.

    Args:
        title: title of the page.
        evaluation: evaluation of the policies of the rounds, in their order.
        links: text and relative address of other pages.
    """
    policies = evaluation.policies
    tables: list[MeasureTable] = [main_table(policies)]
    if failure_kinds(policies):
        tables.append(failure_table(policies))
    return render(
        "rounds.html",
        title=title,
        kicker="Training in rounds",
        run=evaluation.run,
        badges=[f"{len(policies) - 1} rounds", f"{evaluation.episodes} episodes of evaluation"],
        digest=("specs digest", evaluation.specs_digest),
        contents=[("curve", "Curve"), ("measures", "Measures"), ("pages", "Pages")],
        panels=_panels(policies),
        tables=tables,
        conclusions=[conclusion(entry) for entry in evaluation.comparisons],
        intervals=INTERVALS,
        links=links,
    )


def _panels(policies: Sequence[PolicyScores]) -> list[Panel]:
    panels = [draw_panel("success", "Success rate by round, 95 % intervals", _success(policies))]
    if failure_kinds(policies):
        panels.append(draw_panel("failures", "Failures by round", _failures(policies)))
    return panels


def _success(policies: Sequence[PolicyScores]) -> Callable[[Axes], None]:
    splits = dict.fromkeys(group.group for policy in policies for group in policy.groups if group.by == "split")
    names = list(splits) if len(splits) > 1 else ["all"]

    def paint(axes: Axes) -> None:
        for place, (name, tint, dashes) in enumerate(zip(names, cycle(_COLOURS), cycle(_DASHES), strict=False)):
            points = [
                (number + 0.06 * place, share.share, share.low, share.high)
                for number, policy in enumerate(policies)
                for group in (policy.overall, *policy.groups)
                if group.group == name and group.by in ("all", "split")
                for share in (group.success,)
                if share.share is not None and share.low is not None and share.high is not None
            ]
            if points:
                x, rates, lows, highs = zip(*points, strict=True)
                bars = [[100 * (rate - low) for rate, low in zip(rates, lows, strict=True)]]
                bars.append([100 * (high - rate) for rate, high in zip(rates, highs, strict=True)])
                style: dict[str, Any] = {
                    "color": colour(tint),
                    "linestyle": dashes,
                    "marker": ".",
                    "capsize": 3,
                    "label": name,
                }
                axes.errorbar(x, [100 * rate for rate in rates], yerr=bars, **style)
        _finish(axes, "SR, %")

    return paint


def _failures(policies: Sequence[PolicyScores]) -> Callable[[Axes], None]:
    def paint(axes: Axes) -> None:
        kinds = failure_kinds(policies)
        for kind, tint, dashes in zip(kinds, cycle(_COLOURS), cycle(_DASHES), strict=False):
            counts = [
                100 * policy.failures[kind].count / policy.overall.n if kind in policy.failures else 0.0
                for policy in policies
            ]
            axes.plot(range(len(policies)), counts, dashes, marker=".", color=colour(tint), label=str(kind))
        _finish(axes, "share of the episodes, %")

    return paint


def _finish(axes: Axes, unit: str) -> None:
    axes.set_xlabel("round of corrections")
    axes.set_ylabel(unit)
    axes.set_ylim(0, 100)
    count_whole(axes.xaxis)
    write_legend(axes, columns=2)
