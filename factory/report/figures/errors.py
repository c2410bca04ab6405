"""Figure of navigation errors (paper Fig. 8): cumulative distribution by scene, with the success radius."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from factory.html.measures import PLACES
from factory.html.palette import DASHES, colour, scene_colours
from factory.report.data import ReportInput
from factory.report.drawing.canvas import Axes, draw_panel, write_legend
from factory.report.drawing.figure import Figure, Table
from factory.report.drawing.text import count, name, number, percent
from factory.stats import paper
from factory.stats.statistics import ErrorRow

_MARGIN_M = 0.004


def draw(material: ReportInput) -> Figure:
    """Returns the cumulative distributions and the quantiles."""
    title, source = "Navigation error", "Fig. 8, Table VI"
    if not material.episodes:
        return Figure("errors", title, source, "No episodes to show.")
    everything = material.statistics.navigation_error[-1]
    within = everything.within_radius
    place = PLACES[material.statistics.success]
    other = next(name for measure, name in PLACES.items() if measure is not material.statistics.success)
    paper_note = f" The pink line is the paper's mean, {number(paper.NAVIGATION_ERROR.ne_mean_m, 3)} m."
    caption = (
        f"Share of {count(everything.n, 'episode')} whose planar distance to the target's "
        f"{place} at the end (NE) is at most x. "
        f"The dashed line is the success radius, {material.statistics.success_radius_m:g} m: {within.count} of "
        f"{within.of} episodes end within it.{paper_note if material.statistics.beside_paper else ''}"
    )
    panel = draw_panel("ne_cdf", "Cumulative navigation error by scene", lambda axes: _paint(axes, material), 3.3)
    tables = [_table(material.statistics.navigation_error, f"NE to the {place} by scene, metres")]
    if material.statistics.other_error:
        tables.append(_table(material.statistics.other_error, f"NE to the {other} by scene, metres"))
    return Figure("errors", title, source=source, caption=caption, panels=(panel,), tables=tuple(tables))


def _paint(axes: Axes, material: ReportInput) -> None:
    radius = material.statistics.success_radius_m
    every = [row.final_ne_m for row in material.episodes]
    low, high = min(*every, radius) - _MARGIN_M, max(*every, radius) + _MARGIN_M
    for number_, (scene, line) in enumerate(scene_colours(material.scenes).items()):
        errors = np.sort([row.final_ne_m for row in material.of(scene)])
        if not len(errors):
            continue
        heights = np.arange(len(errors) + 1) / len(errors)
        axes.step(
            [low, *errors, high],
            [*heights, 1.0],
            where="post",
            color=line,
            linestyle=DASHES[number_ % len(DASHES)],
            label=f"{name(scene)} ({len(errors)})",
        )
    axes.axvline(radius, color=colour("ink"), linewidth=1.2, linestyle=(0, (4, 2)), label="success radius")
    paper_mean = paper.NAVIGATION_ERROR.ne_mean_m
    if paper_mean is not None and material.statistics.beside_paper:
        axes.axvline(paper_mean, color=colour("paper"), linewidth=1.2, label="paper, mean")
    axes.set_xlim(low, high)
    axes.set_ylim(0, 1.02)
    axes.set_xlabel(f"NE to the {PLACES[material.statistics.success]}, m")
    axes.set_ylabel("share of the episodes")
    write_legend(axes, columns=2)


def _table(errors: Sequence[ErrorRow], title: str) -> Table:
    rows = tuple(
        (
            name(row.group),
            str(row.n),
            number(row.mean, 3),
            number(row.std, 4),
            *(number(row.quantiles.get(level), 3) for level in ("p05", "p50", "p95", "p100")),
            percent(row.within_radius.share),
        )
        for row in errors
    )
    return Table(("scene", "N", "mean", "std", "5 %", "50 %", "95 %", "largest", "within radius"), rows, title)
