"""Draws the floor map of a scene: free floor and obstacles as outlines, and targets."""

from __future__ import annotations

import numpy as np

from factory.html.palette import colour
from factory.report.drawing.canvas import WIDTH_IN, Axes, fill_outlines, mark
from factory.visualize.floor_map import FloorMap
from schemas.dataset.rows import EpisodeSummary

_BESIDE_IN, _ABOVE_IN = 0.45, 0.95
"""`_BESIDE_IN`: width of the labels of the y axis. `_ABOVE_IN`: height of the labels of the x axis, title and legend.
Both are in inches."""
_LEAST_IN, _MOST_IN = 1.5, 7.0


def floor_height_in(floor: FloorMap | None) -> float:
    """Returns the height of a panel in which the map fills the width, inches."""
    if floor is None:
        return WIDTH_IN
    west, east, south, north = floor.bounds_m
    height = (WIDTH_IN - _BESIDE_IN) * (north - south) / (east - west)
    return min(max(height, _LEAST_IN), _MOST_IN) + _ABOVE_IN


def draw_floor(axes: Axes, floor: FloorMap | None) -> None:
    """Draws the map with x to the right and y up, in metres; draws empty axes if there is no map."""
    axes.set_aspect("equal")
    axes.grid(visible=False)
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    axes.spines[["left", "bottom"]].set_visible(False)
    axes.tick_params(length=2)
    if floor is None:
        axes.margins(0.1)
        return
    for level, (outlines, name) in enumerate(((floor.floor, "floor"), (floor.low, "low"), (floor.wall, "wall"))):
        fill_outlines(axes, outlines, colour(name), zorder=level / 10)
    west, east, south, north = floor.bounds_m
    axes.set_xlim(west, east)
    axes.set_ylim(south, north)


def draw_targets(axes: Axes, floor: FloorMap | None, episodes: list[EpisodeSummary]) -> None:
    """Marks all targets of the scene, and highlights the targets of the episodes."""
    if floor is not None:
        edge = {"facecolor": "none", "edgecolor": colour("muted"), "linewidth": 0.6}
        mark(axes, floor.targets_m, s=9, marker="D", zorder=2, **edge)
    if episodes:
        named = np.unique([(row.goal_x_m, row.goal_y_m) for row in episodes], axis=0)
        fill = {"color": colour("ink"), "edgecolor": colour("card"), "linewidth": 0.6}
        mark(axes, named, s=20, marker="D", zorder=4, label=f"target ({len(named)})", **fill)


def title_floor(axes: Axes, text: str) -> None:
    """Draws a title with space for one line of legend below it."""
    axes.set_title(text, pad=20)
