"""Finds the floor: its height and its triangles.

Pure functions. Does not detect obstacles.
"""

from __future__ import annotations

import numpy as np

from schemas.errors import WorldError
from schemas.support.geometry import cross
from schemas.support.numpy_types import Floats

FLOOR_TOLERANCE_M = 0.03
"""Maximum vertical distance of a floor surface from the height of the floor, metres."""
_BIN_M = 0.02
_MIN_AREA_M2 = 2.0
_MIN_SHARE = 0.4
"""Area of the floor as a share of the largest level."""
# less than 1, because a roof or a slab above can be larger than the floor that furniture and walls divide; a pit or a
# hatch below the floor is far smaller


def _facing_up(triangles: Floats) -> tuple[Floats, Floats]:
    """Returns the heights and areas of level, upward-facing triangles; the areas of all others are 0."""
    crosses = cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    doubled = np.linalg.norm(crosses, axis=1)
    level = crosses[:, 2] > 0.98 * doubled
    return triangles[:, :, 2].mean(axis=1), np.where(level, doubled / 2, 0.0)


def level_area_m2(triangles: Floats, height: float, tolerance_m: float) -> float:
    """Returns the area of the level, upward-facing triangles within `tolerance_m` of a height, square metres."""
    heights, areas = _facing_up(triangles)
    return float(areas[np.abs(heights - height) <= tolerance_m].sum())


def find_floor_height(triangles: Floats) -> float:
    """Returns the height of the floor, metres: the lowest level with a large upward-facing area.

    Args:
        triangles: (T, 3, 3) visible triangles, world metres.

    Raises:
        WorldError: the largest level surface is smaller than two square metres.
    """
    heights, areas = _facing_up(triangles)
    bins = np.floor(heights / _BIN_M).astype(np.int64)
    levels, owner = np.unique(bins, return_inverse=True)
    per_level = np.bincount(owner.reshape(-1), weights=areas)
    largest = float(per_level.max(initial=0.0))
    if largest < _MIN_AREA_M2:
        raise WorldError(
            f"the stage has no floor: the largest level surface has {largest:.2f} m2, a floor needs {_MIN_AREA_M2} m2; "
            "check its up axis and unit (upAxis and metersPerUnit of a stage, --up and --unit of other files), and "
            "that the floor is visible and faces up; add a floor to a file without one with --floor M"
        )
    lowest = levels[per_level >= _MIN_SHARE * largest].min()
    chosen = (bins == lowest) & (areas > 0)
    return round(float(np.average(heights[chosen], weights=areas[chosen])), 4)


def floor_triangles(triangles: Floats, height: float) -> Floats:
    """Returns the floor triangles (F, 3, 3) for a height of the floor."""
    heights, areas = _facing_up(triangles)
    return triangles[(areas > 0) & (np.abs(heights - height) <= FLOOR_TOLERANCE_M)]
