"""Computes the spawn points of a floor: points where the robot fits with most headings, evenly spread.

Pure and deterministic. Does not sample at random.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from factory.scenes.navigation.reach import Terrain
from schemas.support.numpy_types import Floats
from workers.geometry.grid import DISC_RADIUS_M

MIN_SPAWNS = 40
"""Recommended minimum number of spawn points of a scene (docs/design/scenes.md#surveyed-points)."""
_USUAL, _MANY, _BIG_AREA_M2 = 64, 96, 250.0
_HEADINGS, _MIN_FREE_HEADINGS = 16, 12
_CLOSEST_M = 0.3


def survey_spawns(terrain: Terrain) -> NDArray[np.float32]:
    """Returns spawn points (S, 2) x, y of the base_link, metres, spread over the connected floor.

    For at least three of four headings, the footprint with the spawn margin is free and on the connected floor. No
    point is within the box of a candidate.
    """
    points = _open_points(terrain)
    area = float(terrain.floor.sum()) * terrain.grid.resolution_m**2
    wanted = _MANY if area > _BIG_AREA_M2 else _USUAL
    if len(points) == 0:
        return np.zeros((0, 2), np.float32)
    return points[_spread(points, terrain.grid.clearance_at(points), wanted)].astype(np.float32)


def _open_points(terrain: Terrain) -> Floats:
    """Returns the centres (N, 2) of cells at which at least 12 of 16 headings fit; tests every second cell."""
    near = terrain.grid.clearance >= DISC_RADIUS_M  # no pose fits in the other cells
    points = terrain.grid.centre_of(2 * np.argwhere(near[::2, ::2]))
    headings = np.zeros(len(points), np.int64)
    for yaw in 2 * np.pi * np.arange(_HEADINGS) / _HEADINGS:
        headings += terrain.can_start(points, yaw)
    return points[headings >= _MIN_FREE_HEADINGS]


def _spread(points: Floats, clearance: Floats, wanted: int) -> NDArray[np.int64]:
    """Farthest-point sampling: starts at the largest clearance, then adds the point farthest from all chosen ones."""
    chosen = [int(clearance.argmax())]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < wanted and distance.max() >= _CLOSEST_M:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)
