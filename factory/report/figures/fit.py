"""Figure of trajectory length against spawn distance (paper Fig. 11) with the fitted line."""

from __future__ import annotations

import numpy as np

from factory.html.palette import TIER_COLOURS, TIER_MARKERS, colour
from factory.report.data import ReportInput
from factory.report.drawing.canvas import Axes, draw_panel, mark, write_legend
from factory.report.drawing.figure import Figure, Table
from factory.report.drawing.text import DASH, count, name, number
from factory.stats.statistics import Fit
from schemas.terms import Tier

_PRINTED_P = 0.001


def draw(material: ReportInput) -> Figure:
    """Returns the scatter plot and the fits of all groups."""
    title, source = "Spawn distance and trajectory length", "Fig. 11"
    if not material.episodes:
        return Figure("fit", title, source, "No episodes to show.")
    fit = material.statistics.correlation[0]
    caption = (
        f"Each mark is one of {count(fit.n, 'episode')}. The dotted line is the straight path to the success region "
        f"(slope 1, start distance minus {material.statistics.success_radius_m:g} m). {_describe_fit(fit)}"
    )
    panel = draw_panel(
        "spawn_distance_vs_tl",
        "Scatter of spawn distance and trajectory length by tier",
        lambda axes: _paint(axes, material, fit),
        3.8,
    )
    return Figure("fit", title, source=source, caption=caption, panels=(panel,), tables=(_table(material),))


def _describe_fit(fit: Fit) -> str:
    if fit.r is None or fit.slope is None or fit.low is None or fit.high is None:
        return f"No line is fitted: {fit.remark}."
    return (
        f"Dashed line, least squares: slope {number(fit.slope)} m/m, intercept {number(fit.intercept_m)} m; Pearson "
        f"r = {number(fit.r, 3)}, 95 % interval {number(fit.low, 3)} to {number(fit.high, 3)}."
    )


def _paint(axes: Axes, material: ReportInput, fit: Fit) -> None:
    for tier in Tier:
        rows = [row for row in material.episodes if row.spawn_tier is tier]
        if rows:
            points = [(row.spawn_dist_m, row.trajectory_length_m) for row in rows]
            look = {"color": colour(TIER_COLOURS[tier]), "edgecolor": colour("card"), "linewidth": 0.4, "alpha": 0.8}
            mark(axes, points, s=22, marker=TIER_MARKERS[tier], label=f"{tier} ({len(rows)})", **look)
    farthest = max(row.spawn_dist_m for row in material.episodes)
    radius = material.statistics.success_radius_m
    ends = np.array([radius, 1.03 * farthest])
    axes.plot(ends, ends - radius, color=colour("muted"), linewidth=1.1, linestyle=(0, (1.2, 2)), label="straight path")
    if fit.slope is not None and fit.intercept_m is not None:
        axes.plot(
            ends,
            fit.slope * ends + fit.intercept_m,
            color=colour("ink"),
            linewidth=1.3,
            linestyle=(0, (5, 3)),
            label="least squares",
        )
        axes.text(
            0.02,
            0.96,
            f"r = {number(fit.r, 3)}\n[{number(fit.low, 3)}, {number(fit.high, 3)}]\nslope {number(fit.slope)}"
            f"\nN {fit.n}",
            transform=axes.transAxes,
            va="top",
            fontsize=8.5,
        )
    axes.set_xlim(left=min(radius, *(row.spawn_dist_m for row in material.episodes)))
    axes.set_ylim(bottom=0)
    axes.set_xlabel("spawn distance, m")
    axes.set_ylabel("trajectory length, m")
    write_legend(axes)


def _table(material: ReportInput) -> Table:
    rows = []
    for fit in material.statistics.correlation:
        if fit.r is None or fit.p is None:
            rows.append((name(fit.group), str(fit.n), DASH, fit.remark, DASH, DASH))
            continue
        interval = f"{number(fit.low, 3)} to {number(fit.high, 3)}"
        p = "< 0.001" if fit.p <= _PRINTED_P else number(fit.p, 3)
        slope = f"{number(fit.slope)} ± {number(fit.slope_error)}"
        rows.append((name(fit.group), str(fit.n), number(fit.r, 3), interval, p, slope))
    return Table(("group", "N", "r", "95 % interval", "p", "slope, m/m"), tuple(rows), "By group; ± one standard error")
