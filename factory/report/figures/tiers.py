"""Figure of spawn tiers (paper Fig. 2): shares and start distances."""

from __future__ import annotations

import numpy as np

from factory.html.measures import PLACES
from factory.html.palette import TIER_COLOURS, colour
from factory.report.data import ReportInput
from factory.report.drawing.canvas import Axes, count_whole, draw_panel, mark, mark_paper, write_legend
from factory.report.drawing.figure import Figure, Table
from factory.report.drawing.text import count, interval, name, number
from factory.stats.statistics import FarRow
from schemas.terms import TIER_RANGE_M, Tier

_BIN_M = 0.5


def draw(material: ReportInput) -> Figure:
    """Returns the shares and the histogram of start distances."""
    total = len(material.episodes)
    title, source = "Spawn tiers", "Fig. 2"
    if not total:
        return Figure("tiers", title, source, "No episodes to show.")
    rows = {row.group: row for row in material.statistics.tiers}
    counts = ", ".join(f"{rows[tier].n} {tier}" for tier in Tier)
    beside = " and that of the paper" if material.statistics.beside_paper else ""
    caption = (
        f"First drawing: share of each tier among {count(total, 'episode')} ({counts}), with the share in the "
        f"plan{beside}. "
        f"Second drawing: planar distance of the start from the target's {PLACES[material.statistics.success]}; the "
        "dotted lines are the tiers' limits at 1.5, 3.5 and 7.0 m. Far starts are surveyed points, and their limits "
        "apply to the distance along the floor."
    )
    shares = draw_panel("spawn_tiers", f"Shares of the tiers: {counts}", lambda axes: _shares(axes, material), 2.6)
    distances = draw_panel(
        "spawn_distances", "Histogram of start distances by tier", lambda axes: _distances(axes, material), 2.8
    )
    tables = (_far_table(material),) if rows[Tier.FAR].n else ()
    return Figure("tiers", title, source=source, caption=caption, panels=(shares, distances), tables=tables)


def _shares(axes: Axes, material: ReportInput) -> None:
    rows = {row.group: row for row in material.statistics.tiers}
    places = np.arange(len(Tier))
    ours = [100 * (rows[tier].share or 0) for tier in Tier]
    axes.barh(places, ours, 0.6, color=[colour(TIER_COLOURS[tier]) for tier in Tier])
    planned = [100 * material.meta.plan.tier_share(tier) for tier in Tier]
    plan = {"marker": "|", "s": 260, "color": colour("ink"), "linewidth": 1.6}
    mark(axes, np.column_stack([planned, places]), label="plan", zorder=3, **plan)
    published = [row.share or 0 for tier in Tier if (row := rows[tier].paper)]
    shares = [100 * share for share in published] or [0.0] * len(Tier)
    if published:
        mark_paper(axes, np.column_stack([shares, places]))
    for place, ends in enumerate(zip(ours, planned, shares, strict=True)):
        axes.text(max(ends) + 2, place, f"{ours[place]:.1f} %", va="center", fontsize=8.5)
    axes.set_yticks(places, list(Tier))
    axes.set_xlim(0, max(*ours, *planned, *shares) + 14)
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("share of the episodes, %")
    write_legend(axes)


def _distances(axes: Axes, material: ReportInput) -> None:
    farthest = max(row.spawn_dist_m for row in material.episodes)
    edges = [float(edge) for edge in np.arange(0, farthest + _BIN_M, _BIN_M)]
    values = [[row.spawn_dist_m for row in material.episodes if row.spawn_tier is tier] for tier in Tier]
    axes.hist(
        values,
        edges,
        stacked=True,
        color=[colour(TIER_COLOURS[tier]) for tier in Tier],
        label=[f"{tier} ({len(group)})" for tier, group in zip(Tier, values, strict=True)],
    )
    for limit in sorted({limit for ends in TIER_RANGE_M.values() for limit in ends}):
        axes.axvline(limit, color=colour("ink"), linewidth=0.9, linestyle=(0, (1.5, 2)))
    axes.set_xlabel("start to target, m")
    axes.set_ylabel("episodes")
    count_whole(axes.yaxis)
    axes.set_xlim(left=0)
    write_legend(axes)


def _far_table(material: ReportInput) -> Table:
    rows = tuple(
        (name(row.scene), str(row.n), _mean(row), interval(row.short), interval(row.corner))
        for row in material.statistics.far
        if row.n
    )
    below = f"below {material.statistics.far[0].least_m:g} m"
    columns = ("scene", "N", "floor distance, m", below, "no free line")
    return Table(columns, rows, "Far starts: distance along the floor to the target; 95 % intervals")


def _mean(row: FarRow) -> str:
    if row.interval_m is None:
        return number(row.mean_m)
    low, high = row.interval_m
    return f"{number(row.mean_m)} ({number(low)}–{number(high)})"
