"""Figure of trajectory lengths (paper Fig. 7)."""

from __future__ import annotations

import numpy as np

from factory.html.palette import colour, scene_colours
from factory.report.data import ReportInput
from factory.report.drawing.canvas import Axes, count_whole, draw_panel, write_legend
from factory.report.drawing.figure import Figure
from factory.report.drawing.text import count, name, number
from factory.stats import paper

_BIN_M = 0.5


def draw(material: ReportInput) -> Figure:
    """Returns the histogram."""
    title, source = "Trajectory length", "Fig. 7, Table V"
    if not material.episodes:
        return Figure("lengths", title, source, "No episodes to show.")
    everything = material.statistics.scenes[-1]
    paper_mean = f"{number(paper.OVERALL.tl_mean_m)} m over {paper.OVERALL.n} episodes"
    beside = f"; the dashed line is the paper's mean, {paper_mean}" if material.statistics.beside_paper else ""
    caption = (
        f"Trajectory lengths (TL) of {count(everything.n, 'episode')}, stacked by scene in bins of {_BIN_M:g} m; the "
        f"outline is the sum. Mean {number(everything.tl_mean_m)} m, median {number(everything.tl_median_m)} m{beside}."
    )
    panel = draw_panel(
        "tl_histogram", "Histogram of trajectory lengths by scene", lambda axes: _paint(axes, material), 3.2
    )
    return Figure("lengths", title, source=source, caption=caption, panels=(panel,))


def _paint(axes: Axes, material: ReportInput) -> None:
    lengths = {scene: [row.trajectory_length_m for row in material.of(scene)] for scene in material.scenes}
    everything = [length for group in lengths.values() for length in group]
    edges = [float(edge) for edge in np.arange(0, max(everything) + _BIN_M, _BIN_M)]
    fills = scene_colours(material.scenes)
    axes.hist(
        list(lengths.values()),
        edges,
        stacked=True,
        color=list(fills.values()),
        edgecolor=colour("card"),
        linewidth=0.4,
        label=[f"{name(scene)} ({len(group)})" for scene, group in lengths.items()],
    )
    axes.hist(everything, edges, histtype="step", color=colour("ink"), linewidth=1.2)
    mean = material.statistics.scenes[-1].tl_mean_m
    if mean is not None:
        axes.axvline(mean, color=colour("ink"), linewidth=1.3, label=f"mean {mean:.2f} m")
    if material.statistics.beside_paper and paper.OVERALL.tl_mean_m is not None:
        paper_mean = paper.OVERALL.tl_mean_m
        axes.axvline(
            paper_mean, color=colour("paper"), linewidth=1.3, linestyle=(0, (4, 2)), label=f"paper {paper_mean:.2f} m"
        )
    axes.set_xlim(left=0)
    axes.set_xlabel("trajectory length, m")
    axes.set_ylabel("episodes")
    count_whole(axes.yaxis)
    write_legend(axes, columns=2)
