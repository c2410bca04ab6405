"""Converts a compiled scene to a floor map: outlines of floor and obstacles, targets, spawn points. Pure functions."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.scene import CompiledScene

Corner = tuple[int, int]

Outlines = list[NDArray[np.float64]]
"""Closed loops of points (K, 2); holes are separate loops."""
_MARGIN_M = 0.3


@dataclass(frozen=True)
class FloorMap:
    """Floor map of a scene in the world frame, metres."""

    bounds_m: tuple[float, float, float, float]
    """West, east, south and north bound of the non-empty area, metres."""
    floor: Outlines
    """Outlines of the connected floor."""
    low: Outlines
    """Outlines of all obstacles."""
    wall: Outlines
    """Outlines of the obstacles that occlude the view."""
    surveyed_m: NDArray[np.float32]
    """(S, 2) surveyed spawn points, metres."""
    targets_m: NDArray[np.float64]
    """(K, 2) centroids of all targets, metres."""
    free_area_m2: float


def map_of(scene: CompiledScene) -> FloorMap:
    return FloorMap(
        bounds_m=_bounds(scene),
        floor=_outlines(scene, scene.reachable > 0),
        low=_outlines(scene, scene.occupancy > 0),
        wall=_outlines(scene, scene.occupancy > 1),
        surveyed_m=scene.spawns,
        targets_m=np.array([target.centroid_m[:2] for target in scene.info.targets], np.float64).reshape(-1, 2),
        free_area_m2=scene.info.free_area_m2,
    )


def _outlines(scene: CompiledScene, mask: NDArray[np.bool_]) -> Outlines:
    origin = np.array(scene.info.grid_origin_m)
    return [loop * scene.info.grid_resolution_m + origin for loop in trace_outlines(mask)]


def _bounds(scene: CompiledScene) -> tuple[float, float, float, float]:
    """Returns the west, east, south and north bound of the cells that are not outside and not empty, metres."""
    (west, south), edge = scene.info.grid_origin_m, scene.info.grid_resolution_m
    rows, columns = np.nonzero((scene.occupancy > 0) | (scene.reachable > 0))
    if not len(rows):
        rows, columns = (np.array([0, side - 1]) for side in scene.occupancy.shape)
    return (
        float(west + columns.min() * edge - _MARGIN_M),
        float(west + (columns.max() + 1) * edge + _MARGIN_M),
        float(south + rows.min() * edge - _MARGIN_M),
        float(south + (rows.max() + 1) * edge + _MARGIN_M),
    )


def trace_outlines(mask: NDArray[np.bool_]) -> list[NDArray[np.float64]]:
    """Returns closed loops around all regions of True cells; loops of holes have the opposite direction.

    Args:
        mask: (H, W) cells.

    Returns:
        Loops of corners (K, 2) as column, row in cells; the last corner connects to the first; collinear corners are
        removed.
    """
    following = _directed_edges(mask)
    loops = []
    while following:
        start = next(iter(following))
        loop, here = [start], _take(following, start)
        while here != start:
            loop.append(here)
            here = _take(following, here)
        loops.append(_without_straight_runs(np.array(loop, np.float64)))
    return loops


def _directed_edges(mask: NDArray[np.bool_]) -> dict[Corner, list[Corner]]:
    """Returns the corners that follow each corner along the outline.

    The region is left of each edge if the row axis points up.
    """
    padded = np.pad(mask, 1)
    following: dict[Corner, list[Corner]] = defaultdict(list)
    below, here = padded[:-1, 1:-1], padded[1:, 1:-1]
    for row, column in np.argwhere(here & ~below).tolist():
        following[column, row].append((column + 1, row))
    for row, column in np.argwhere(below & ~here).tolist():
        following[column + 1, row].append((column, row))
    left, right = padded[1:-1, :-1], padded[1:-1, 1:]
    for row, column in np.argwhere(left & ~right).tolist():
        following[column, row].append((column, row + 1))
    for row, column in np.argwhere(right & ~left).tolist():
        following[column, row + 1].append((column, row))
    return following


def _take(following: dict[Corner, list[Corner]], corner: Corner) -> Corner:
    ends = following[corner]
    end = ends.pop()
    if not ends:
        del following[corner]
    return end


def _without_straight_runs(loop: NDArray[np.float64]) -> NDArray[np.float64]:
    before, after = loop - np.roll(loop, 1, axis=0), np.roll(loop, -1, axis=0) - loop
    corners: NDArray[np.float64] = loop[(before != after).any(axis=1)]
    return corners
