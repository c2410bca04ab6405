"""Figure of episode lengths in steps by scene (paper Fig. 9)."""

from __future__ import annotations

import numpy as np

from factory.html.palette import colour, scene_colours
from factory.report.comparison.reasons import facts_of
from factory.report.data import ReportInput
from factory.report.drawing.canvas import Axes, draw_panel, mark_paper, write_legend
from factory.report.drawing.figure import Figure, Table
from factory.report.drawing.text import count, name, number, scene_label


def draw(material: ReportInput) -> Figure:
    """Returns the box plots."""
    title, source = "Steps by scene", "Fig. 9"
    if not material.episodes:
        return Figure("steps", title, source, "No episodes to show.")
    beside = " Diamonds are the paper's medians." if material.statistics.beside_paper else ""
    caption = (
        f"Steps of {count(len(material.episodes), 'episode')} at {material.meta.plan.task.control_hz} Hz. Box: "
        "quartiles with the median; whiskers: 1.5 times the interquartile range; dots: outliers; the white dot is the "
        f"mean μ.{beside}"
    )
    panel = draw_panel(
        "steps_by_scene",
        "Box plots of the steps by scene",
        lambda axes: _paint(axes, material),
        1.3 + 0.5 * len(material.scenes),
    )
    return Figure("steps", title, source=source, caption=caption, panels=(panel,), tables=(_geometry(material),))


def _paint(axes: Axes, material: ReportInput) -> None:
    groups = [[row.num_steps for row in material.of(scene)] for scene in material.scenes]
    boxes = axes.boxplot(
        groups,
        orientation="horizontal",
        widths=0.55,
        patch_artist=True,
        showmeans=True,
        medianprops={"color": colour("ink"), "linewidth": 1.6},
        meanprops={
            "marker": "o",
            "markersize": 4.5,
            "markerfacecolor": colour("card"),
            "markeredgecolor": colour("ink"),
        },
        flierprops={"marker": "o", "markersize": 3, "markeredgecolor": colour("muted"), "markerfacecolor": "none"},
        whiskerprops={"color": colour("muted")},
        capprops={"color": colour("muted")},
        boxprops={"edgecolor": colour("muted"), "linewidth": 0.8},
    )
    for box, fill in zip(boxes["boxes"], scene_colours(material.scenes).values(), strict=True):
        box.set_facecolor(fill)
    for place, group in enumerate(groups, 1):
        if group:
            axes.text(
                max(group), place + 0.36, f"μ {np.mean(group):.0f}  N {len(group)}", fontsize=8, ha="right", va="top"
            )
    published = {row.group: row.paper.steps_median for row in material.statistics.scenes if row.paper}
    medians = [published.get(scene) for scene in material.scenes]
    known = [(median, place) for place, median in enumerate(medians, 1) if median is not None]
    if known:
        mark_paper(axes, known, "paper, median")
        write_legend(axes)
    axes.set_yticks(range(1, len(groups) + 1), [scene_label(scene) for scene in material.scenes])
    axes.set_ylim(len(groups) + 0.6, 0.4)
    axes.set_xlim(left=0)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("steps")


def _geometry(material: ReportInput) -> Table:
    """Returns the table of distances and speeds that determine the steps of a scene."""
    rows = []
    for scene in material.scenes:
        facts, floor = facts_of(material.of(scene)), material.maps.get(scene)
        if facts is not None:
            rows.append(
                (
                    name(scene),
                    number(facts.spawn_m),
                    number(facts.geodesic_m),
                    number(facts.tl_m),
                    number(facts.detour_m),
                    number(facts.steps_per_m, 1),
                    number(None if floor is None else floor.free_area_m2, 0),
                )
            )
    columns = (
        "scene",
        "start, m",
        "shortest path, m",
        "TL, m",
        "detour, m",
        "steps/m",
        "floor, m²",
    )
    return Table(columns, tuple(rows), "Geometry by scene, means")
