"""Figure of mean length and steps by tier (paper Fig. 10 and Table VII)."""

from __future__ import annotations

import numpy as np

from factory.html.palette import TIER_COLOURS, colour
from factory.report.data import ReportInput
from factory.report.drawing.canvas import Axes, draw_panel, mark_paper, write_legend
from factory.report.drawing.figure import Figure, Table
from factory.report.drawing.text import count, name, number
from factory.stats import paper
from factory.stats.statistics import RolloutRow
from schemas.terms import Tier


def draw(material: ReportInput) -> Figure:
    """Returns two bar charts."""
    title, source = "Length and steps by tier", "Fig. 10, Table VII"
    if not material.episodes:
        return Figure("tier_statistics", title, source, "No episodes to show.")
    rows = {row.group: row for row in material.statistics.tiers}
    counts = ", ".join(f"{rows[tier].n} {tier}" for tier in Tier)
    paper_note = f"; diamonds are the paper's means over {', '.join(f'{paper.TIERS[tier].n} {tier}' for tier in Tier)}"
    beside = material.statistics.beside_paper
    caption = (
        f"Means by tier over {count(len(material.episodes), 'episode')} ({counts})"
        f"{paper_note if beside else ''}.{_ratios(rows, beside)}"
    )
    lengths = draw_panel(
        "tier_lengths",
        "Mean trajectory length by tier",
        lambda axes: _bars(axes, rows, field="tl_mean_m", label="mean trajectory length, m", digits=2),
        2.3,
    )
    steps = draw_panel(
        "tier_steps",
        "Mean steps by tier",
        lambda axes: _bars(axes, rows, field="steps_mean", label="mean steps", digits=0),
        2.3,
    )
    return Figure(
        "tier_statistics", title, source=source, caption=caption, panels=(lengths, steps), tables=(_table(material),)
    )


def _ratios(rows: dict[str, RolloutRow], beside: bool) -> str:
    near = rows[Tier.NEAR]
    parts = []
    for tier in (Tier.MID, Tier.FAR):
        length, steps = rows[tier].tl_mean_m, rows[tier].steps_mean
        if length is not None and steps is not None and near.tl_mean_m and near.steps_mean:
            parts.append(
                f"trajectories of tier {tier} are {length / near.tl_mean_m:.1f} times as long as those of tier near "
                f"and have {steps / near.steps_mean:.1f} times the steps"
            )
    paper_note = " (paper, far: 2.9 and 3.2)" if beside else ""
    return f" In this dataset, {'; '.join(parts)}{paper_note}." if parts else ""


def _bars(axes: Axes, rows: dict[str, RolloutRow], field: str, label: str, digits: int) -> None:
    places = np.arange(len(Tier))
    values = [getattr(rows[tier], field) for tier in Tier]
    published = [getattr(row, field) for tier in Tier if (row := rows[tier].paper)] or [0.0] * len(Tier)
    axes.barh(places, [value or 0 for value in values], 0.6, color=[colour(TIER_COLOURS[tier]) for tier in Tier])
    if any(published):
        mark_paper(axes, np.column_stack([published, places]))
    top = max([value or 0 for value in values] + published) or 1.0
    for place, value in enumerate(values):
        beyond = max(value or 0, published[place] or 0) + 0.03 * top
        axes.text(beyond, place, number(value, digits), va="center", fontsize=8.5)
    axes.set_yticks(places, [f"{tier} ({rows[tier].n})" for tier in Tier])
    axes.set_xlim(0, 1.16 * top)
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.set_xlabel(label)
    if any(published):
        write_legend(axes)


def _table(material: ReportInput) -> Table:
    rows = tuple(
        (name(row.group), str(row.n), number(row.tl_mean_m), number(row.steps_mean, 1), number(row.ne_mean_m, 3))
        for row in material.statistics.scene_tiers
        if row.n
    )
    return Table(("scene / tier", "N", "TL mean, m", "steps mean", "NE mean, m"), rows, "By scene and tier")
