"""The driven trajectories, by tier, over the map of each scene; the paper has no such figure."""

from __future__ import annotations

from factory.html.palette import TIER_COLOURS, colour
from factory.report.data import ReportInput
from factory.report.drawing.canvas import (
    Axes,
    Panel,
    draw_floor,
    draw_panel,
    draw_targets,
    floor_height_in,
    title_floor,
    write_legend,
)
from factory.report.drawing.figure import Figure
from factory.report.drawing.text import count, file_part, name
from schemas.terms import Tier


def draw(material: ReportInput) -> Figure:
    """Returns one panel per scene."""
    tracks = material.drives.tracks
    title, source = "Driven trajectories", "not in the paper"
    if not tracks:
        return Figure("tracks", title, source, "No trajectories to show: no episode could be read.")
    read = f"{len(tracks)} of {count(len(material.episodes), 'episode')}"
    caption = (
        f"Trajectories of base_link in {read} over the maps, from the start (dot) to within "
        f"{material.statistics.success_radius_m:g} m of a target (filled diamond). The proportional expert drives "
        "straight; curves show a planner or a start that faces away from the target."
    )
    return Figure(
        "tracks",
        title,
        source=source,
        caption=caption,
        panels=tuple(_panel(material, scene) for scene in material.places),
        wide=True,
    )


def _panel(material: ReportInput, scene: str) -> Panel:
    floor = material.maps.get(scene)
    episodes = [row for row in material.of(scene) if row.episode_id in material.drives.tracks]

    def paint(axes: Axes) -> None:
        draw_floor(axes, floor)
        draw_targets(axes, floor, episodes)
        for tier in Tier:
            fill = colour(TIER_COLOURS[tier])
            members = [row.episode_id for row in episodes if row.spawn_tier is tier]
            for number, episode_id in enumerate(members):
                label = f"{tier} ({len(members)})" if number == 0 else None
                track = material.drives.tracks[episode_id]
                axes.plot(*track.T, color=fill, linewidth=1.3, alpha=0.85, zorder=3, label=label)
                axes.plot(*track[0], marker="o", markersize=2.6, color=fill, zorder=3.5)
        title_floor(axes, f"{name(scene)} (N {len(episodes)})")
        if episodes:
            write_legend(axes, columns=4, handlelength=0.9)

    alt = f"Map of {name(scene)} with {count(len(episodes), 'track')}"
    return draw_panel(f"tracks_{file_part(scene)}", alt, paint, floor_height_in(floor))
