"""Figure of start positions (paper Fig. 4): spawn points, starts by tier and targets on the map of each scene."""

from __future__ import annotations

from factory.html.palette import TIER_COLOURS, TIER_MARKERS, colour
from factory.report.data import ReportInput
from factory.report.drawing.canvas import (
    Axes,
    Panel,
    draw_floor,
    draw_panel,
    draw_targets,
    floor_height_in,
    mark,
    title_floor,
    write_legend,
)
from factory.report.drawing.figure import Figure
from factory.report.drawing.text import count, file_part, name
from schemas.terms import Tier


def draw(material: ReportInput) -> Figure:
    """Returns one panel per scene."""
    surveyed = ", ".join(f"{name(scene)} {len(floor.surveyed_m)}" for scene, floor in material.maps.items())
    beside = "; 40 per scene in the paper" if material.statistics.beside_paper else ""
    caption = (
        f"Starts of {count(len(material.episodes), 'episode')} by tier, over the map of each scene: the reachable "
        "floor is pale, low objects are grey, and objects that occlude the view are dark grey. Small crosses are the "
        f"surveyed spawn points, from which far starts are drawn ({surveyed or 'no map could be read'}{beside}); "
        "hollow diamonds are all targets, filled diamonds those of episodes."
    )
    return Figure(
        "spawn_maps",
        "Start positions",
        source="Fig. 4",
        caption=caption,
        panels=tuple(_panel(material, s) for s in material.places),
        wide=True,
    )


def _panel(material: ReportInput, scene: str) -> Panel:
    floor, episodes = material.maps.get(scene), material.of(scene)

    def paint(axes: Axes) -> None:
        draw_floor(axes, floor)
        draw_targets(axes, floor, episodes)
        if floor is not None:
            mark(axes, floor.surveyed_m, s=13, marker="x", color=colour("muted"), linewidth=0.8, zorder=1.5)
        for tier in Tier:
            starts = [(row.spawn_x_m, row.spawn_y_m) for row in episodes if row.spawn_tier is tier]
            look = {"color": colour(TIER_COLOURS[tier]), "edgecolor": colour("card"), "linewidth": 0.6}
            mark(axes, starts, s=24, marker=TIER_MARKERS[tier], zorder=3, label=f"{tier} ({len(starts)})", **look)
        title_floor(axes, f"{name(scene)} (N {len(episodes)})")
        if episodes:
            write_legend(axes, columns=4, handletextpad=0.1)

    alt = f"Map of {name(scene)} with the starts of {count(len(episodes), 'episode')}"
    return draw_panel(f"spawn_map_{file_part(scene)}", alt, paint, floor_height_in(floor))
