"""Figure of object categories (paper Fig. 6), stacked by scene."""

from __future__ import annotations

from collections import Counter

import numpy as np

from factory.html.palette import colour, scene_colours
from factory.report.data import ReportInput
from factory.report.drawing.canvas import Axes, draw_panel, mark_paper, write_legend
from factory.report.drawing.figure import Figure, Table
from factory.report.drawing.text import DASH, count, name, percent


def draw(material: ReportInput) -> Figure:
    """Returns the bar chart by category, and the counts by category and scene."""
    title, source = "Object categories", "Fig. 6"
    if not material.episodes:
        return Figure("categories", title, source, "No episodes to show.")
    rows = material.statistics.categories
    held_out = sum(row.n for row in rows if row.kind == "held out")
    beside = " Diamonds show the three shares in the paper." if material.statistics.beside_paper else ""
    caption = (
        f"Target categories of {count(len(material.episodes), 'episode')}, most frequent first, stacked by scene; "
        f"a star marks held-out categories ({count(held_out, 'episode')}), which occur in test_ood_obj only.{beside}"
    )
    panel = draw_panel(
        "categories", "Bars of the categories by scene", lambda axes: _paint(axes, material), 1.2 + 0.27 * len(rows)
    )
    return Figure("categories", title, source=source, caption=caption, panels=(panel,), tables=(_table(material),))


def _counts(material: ReportInput) -> Counter[tuple[str, str]]:
    return Counter((row.scene, row.target_category) for row in material.episodes)


def _paint(axes: Axes, material: ReportInput) -> None:
    rows, counts, total = material.statistics.categories, _counts(material), len(material.episodes)
    places, left = np.arange(len(rows)), np.zeros(len(rows))
    for scene, fill in scene_colours(material.scenes).items():
        widths = np.array([100 * counts[scene, row.group] / total for row in rows])
        if widths.any():
            axes.barh(places, widths, 0.66, left, color=fill, edgecolor=colour("card"), label=name(scene))
        left += widths
    published = [(100 * row.paper.share, place) for place, row in enumerate(rows) if row.paper and row.paper.share]
    mark_paper(axes, published)
    for place, row in enumerate(rows):
        beyond = max(left[place], 100 * (row.paper.share or 0) + 0.5 if row.paper else 0)
        axes.text(beyond + 0.5, place, str(row.n), va="center", fontsize=8, color=colour("muted"))
    axes.set_yticks(places, [name(row.group) + (" *" if row.kind == "held out" else "") for row in rows])
    axes.invert_yaxis()
    axes.margins(y=0.02)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("share of the episodes, %")
    write_legend(axes, columns=2)


def _table(material: ReportInput) -> Table:
    counts = _counts(material)
    rows = tuple(
        (
            name(row.group),
            row.kind,
            *(str(counts[scene, row.group] or DASH) for scene in material.scenes),
            str(row.n),
            percent(row.share),
        )
        for row in material.statistics.categories
    )
    return Table(
        ("category", "kind", *map(name, material.scenes), "all", "share"), rows, "Episodes by category and scene"
    )
