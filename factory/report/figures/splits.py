"""Figure of splits by scene (paper Fig. 5)."""

from __future__ import annotations

import numpy as np

from factory.html.palette import SPLIT_COLOURS, colour
from factory.report.data import ReportInput
from factory.report.drawing.canvas import Axes, draw_panel, write_legend
from factory.report.drawing.figure import Figure, Table
from factory.report.drawing.text import count, name, number, percent, scene_label
from schemas.plan import PAPER_SPLITS
from schemas.terms import Split


def draw(material: ReportInput) -> Figure:
    """Returns the stacked bar chart, and tables of the rollouts and of the instances shared with training by split."""
    title, source = "Splits", "Fig. 5, Table VI"
    if not material.episodes:
        return Figure("splits", title, source, "No episodes to show.")
    caption = (
        f"{count(len(material.episodes), 'episode')} by scene and split, in per cent of each scene; numbers are "
        "episodes. Blue and green: splits like training; yellow: new templates; red: held-out categories."
    )
    panel = draw_panel(
        "splits",
        "Stacked bars of the splits by scene",
        lambda axes: _paint(axes, material),
        1.4 + 0.45 * len(material.scenes),
    )
    return Figure(
        "splits",
        title,
        source=source,
        caption=caption,
        panels=(panel,),
        tables=(_rollouts(material), _overlap(material)),
    )


def _paint(axes: Axes, material: ReportInput) -> None:
    totals = [max(len(material.of(scene)), 1) for scene in material.scenes]
    places, left = np.arange(len(totals)), np.zeros(len(totals))
    for split in Split:
        counts = [sum(row.split is split for row in material.of(scene)) for scene in material.scenes]
        if split not in PAPER_SPLITS and not any(counts):
            continue
        widths = 100 * np.array(counts) / totals
        axes.barh(places, widths, 0.62, left, color=colour(SPLIT_COLOURS[split]), edgecolor=colour("card"), label=split)
        for place, (n, width) in enumerate(zip(counts, widths, strict=True)):
            if width > 4:
                axes.text(
                    left[place] + width / 2, place, str(n), ha="center", va="center", fontsize=8, color=colour("card")
                )
        left += widths
    axes.set_yticks(places, [scene_label(scene) for scene in material.scenes])
    axes.set_xlim(0, 100)
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("share of the scene's episodes, %")
    write_legend(axes, columns=2)


def _rollouts(material: ReportInput) -> Table:
    rows = []
    for row in material.statistics.splits:
        means = (number(row.ne_mean_m, 3), number(row.tl_mean_m), number(row.tl_median_m))
        rows.append((row.group, str(row.n), *means, number(row.steps_mean, 1), number(row.steps_median, 0)))
    columns = ("split", "N", "NE mean", "TL mean", "TL median", "steps mean", "steps median")
    return Table(columns, tuple(rows), "Rollouts by split, metres")


def _overlap(material: ReportInput) -> Table:
    rows = tuple(
        (row.split, str(row.targets), str(row.shared), percent(row.share))
        for row in material.statistics.overlap
        if row.scene == "all"
    )
    columns = ("split", "instances", "also in train_id", "share")
    return Table(columns, rows, f"Target instances that also occur in {name('train_id')}")
