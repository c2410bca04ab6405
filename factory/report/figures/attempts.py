"""Figure of attempts by scene with outcomes and reasons (paper Sec. V-A, which has no figure of them)."""

from __future__ import annotations

from collections import Counter

import numpy as np

from factory.html.palette import REASON_COLOURS, colour
from factory.report.data import ReportInput
from factory.report.drawing.canvas import Axes, count_whole, draw_panel, write_legend
from factory.report.drawing.figure import Figure, Table
from factory.report.drawing.text import DASH, count, interval, name, scene_label
from factory.stats.counts import first_of_near_and_mid
from factory.stats.statistics import AttemptRow


def draw(material: ReportInput) -> Figure:
    """Returns the bar chart of outcomes and the success rates."""
    title, source = "Attempts and success", "Sec. V-A; no figure in the paper"
    rows = material.statistics.attempts
    if rows is None:
        return Figure("attempts", title, source, "Not shown: the table of attempts cannot be read.")
    by_scene = [row for row in rows if row.group in material.scenes]
    everything = next(row for row in rows if row.group == "all")
    if not everything.attempts:
        return Figure("attempts", title, source, "No attempts to show.")
    uncounted = sum(Counter(everything.reasons).values()) - (everything.attempts - everything.success.count)
    beside = material.statistics.beside_paper
    marks = "; pink band: range in the paper" if beside else ""
    caption = (
        f"{count(everything.attempts, 'attempt')} for {count(everything.success.count, 'episode')}. First drawing: "
        "attempts by scene and outcome. Second drawing: success rate with its 95 % Wilson interval; hollow dots: "
        f"success rate of first attempts from near and mid starts{marks}. "
        f"Attempts that ended with a crash or a lost lease are not counted ({uncounted})."
    )
    height = 1.3 + 0.42 * len(by_scene)
    outcomes = draw_panel("attempts", "Attempts by scene and outcome", lambda axes: _outcomes(axes, by_scene), height)
    rates = draw_panel("success_rates", "Success rates by scene", lambda axes: _rates(axes, by_scene, rows), height)
    return Figure(
        "attempts",
        title,
        source=source,
        caption=caption,
        panels=(outcomes, rates),
        tables=(_table([*by_scene, everything], rows),),
    )


def _outcomes(axes: Axes, rows: list[AttemptRow]) -> None:
    places = np.arange(len(rows))
    left = np.array([row.success.count for row in rows], float)
    axes.barh(places, left, 0.62, color=colour("won"), edgecolor=colour("card"), label="success")
    for reason, fill in REASON_COLOURS.items():
        counts = np.array([row.reasons.get(reason, 0) for row in rows], float)
        if counts.any():
            axes.barh(places, counts, 0.62, left, color=colour(fill), edgecolor=colour("card"), label=name(reason))
        left += counts
    for place, row in enumerate(rows):
        axes.text(left[place], place, f" {row.attempts}", va="center", fontsize=8.5)
    axes.set_yticks(places, [scene_label(row.group) for row in rows])
    axes.set_xlim(0, 1.1 * max(left.max(), 1))
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("attempts")
    count_whole(axes.xaxis)
    write_legend(axes)


def _rates(axes: Axes, rows: list[AttemptRow], groups: tuple[AttemptRow, ...]) -> None:
    is_labelled = False
    for place, row in enumerate(rows):
        if row.paper is not None and row.paper.rate is not None:
            low, high = row.paper.rate
            axes.barh(
                place,
                100 * (high - low),
                0.66,
                100 * low,
                color=colour("paper"),
                alpha=0.25,
                label=None if is_labelled else "paper",
            )
            is_labelled = True
        share = row.success
        if share.share is not None and share.low is not None and share.high is not None:
            axes.plot(
                [100 * share.low, 100 * share.high],
                [place, place],
                color=colour("won"),
                linewidth=2,
                solid_capstyle="butt",
            )
            axes.plot(
                100 * share.share,
                place,
                "o",
                markersize=6.5,
                color=colour("won"),
                label=None if place else "all attempts",
            )
        first = first_of_near_and_mid(groups, row.group)
        if first.share is not None:
            axes.plot(
                100 * first.share,
                place,
                "o",
                markersize=8.5,
                markerfacecolor="none",
                markeredgewidth=1.3,
                color=colour("ink"),
                label=None if place else "first attempts, near and mid",
            )
    axes.set_yticks(range(len(rows)), [scene_label(row.group) for row in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_xlim(0, 104)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("success rate of attempts, %")
    write_legend(axes)


def _table(shown: list[AttemptRow], rows: tuple[AttemptRow, ...]) -> Table:
    groups = [row for row in rows if " / " in row.group and row.attempts]
    body = tuple(
        (
            name(row.group),
            str(row.attempts),
            interval(row.success),
            interval(row.first),
            ", ".join(f"{n} {name(reason)}" for reason, n in row.reasons.items()) or DASH,
        )
        for row in (*shown, *groups)
    )
    return Table(
        ("scene / tier", "attempts", "success (95 %)", "first attempts", "failures"), body, "By scene and tier"
    )
