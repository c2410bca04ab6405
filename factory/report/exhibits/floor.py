"""Draws a scene's floor from above: the room to drive in and what stands on it, as outlines that can be recoloured."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coordinator.summary import EpisodeSummary
from factory.report.canvas import WIDTH_IN, Axes, fill_outlines
from factory.report.material import FloorMap
from factory.report.outlines import trace_outlines
from factory.report.palette import colour

__all__ = ["draw_floor", "draw_targets", "floor_height_in"]

_MARGIN_M = 0.3
_LABELS_IN = 0.75
"""What title, axis and legend take of the height."""


def floor_height_in(floor: FloorMap | None) -> float:
    """Returns how high a panel must be for the map to fill its width."""
    if floor is None:
        return WIDTH_IN
    west, east, south, north = _bounds(floor)
    return float(np.clip((WIDTH_IN - 0.5) * (north - south) / (east - west), 1.5, 1.6 * WIDTH_IN)) + _LABELS_IN


def draw_floor(axes: Axes, floor: FloorMap | None) -> None:
    """Draws the map, or the bare axes where there is none; x to the right, y up, metres."""
    axes.set_aspect("equal")
    axes.grid(visible=False)
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    axes.spines[["left", "bottom"]].set_visible(False)
    axes.tick_params(length=2)
    if floor is None:
        axes.margins(0.1)
        return
    _fill(axes, floor, floor.reachable > 0, "floor", 0)
    _fill(axes, floor, floor.occupancy > 0, "low", 0.1)
    _fill(axes, floor, floor.occupancy > 1, "wall", 0.2)
    west, east, south, north = _bounds(floor)
    axes.set_xlim(west, east)
    axes.set_ylim(south, north)


def draw_targets(axes: Axes, floor: FloorMap | None, episodes: list[EpisodeSummary]) -> None:
    """Marks all targets of the scene, and those that episodes name more strongly."""
    if floor is not None and len(floor.targets_m):
        axes.scatter(
            *floor.targets_m.T, s=9, marker="D", facecolor="none", edgecolor=colour("muted"), linewidth=0.6, zorder=2
        )
    if episodes:
        named = np.unique([(row.goal_x_m, row.goal_y_m) for row in episodes], axis=0)
        axes.scatter(
            *named.T,
            s=20,
            marker="D",
            color=colour("ink"),
            edgecolor=colour("card"),
            linewidth=0.6,
            zorder=4,
            label=f"named target ({len(named)})",
        )


def _fill(axes: Axes, floor: FloorMap, mask: NDArray[np.bool_], name: str, zorder: float) -> None:
    """Fills the cells of a mask as one path; outlines follow the cells' edges."""
    west, _, south, _ = floor.extent_m
    loops = [loop * floor.resolution_m + (west, south) for loop in trace_outlines(mask)]
    fill_outlines(axes, loops, colour(name), zorder)


def _bounds(floor: FloorMap) -> tuple[float, float, float, float]:
    """West, east, south, north end of what is neither outside nor empty."""
    west, _, south, _ = floor.extent_m
    rows, columns = np.nonzero((floor.occupancy > 0) | (floor.reachable > 0))
    if not len(rows):
        return floor.extent_m
    edge = floor.resolution_m
    return (
        west + columns.min() * edge - _MARGIN_M,
        west + (columns.max() + 1) * edge + _MARGIN_M,
        south + rows.min() * edge - _MARGIN_M,
        south + (rows.max() + 1) * edge + _MARGIN_M,
    )
