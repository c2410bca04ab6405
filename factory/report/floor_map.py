"""A compiled scene as a map for figures: outlines of floor and obstacles, targets, surveyed points. Pure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from factory.report.material import FloorMap, Outlines
from factory.report.outlines import trace_outlines
from schemas.scene import CompiledScene

__all__ = ["map_of"]

_MARGIN_M = 0.3


def map_of(scene: CompiledScene) -> FloorMap:
    """Returns the map of a scene."""
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
    """West, east, south, north end of what is neither outside nor empty."""
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
