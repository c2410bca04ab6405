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
SUNK_M = 0.004
"""Depth of an added floor below a floor at its height, so the two do not flicker; within the floor's skin."""
_BIN_M = 0.02
_MIN_AREA_M2 = 2.0
_MIN_SHARE = 0.4
"""Area of the floor as a share of the largest level."""
_SLAB_BINS, _COVERED_SHARE = 20, 0.6
"""A level within 0.4 m, in which the robot does not fit, that covers this share of a lower one is the floor."""
# less than 1, because a roof or a slab above can be larger than the floor that furniture and walls divide; a pit or a
# hatch below the floor is far smaller


def _facing_up(triangles: Floats) -> tuple[Floats, Floats]:
    """Returns the heights and areas of level, upward-facing triangles; the areas of all others are 0."""
    crosses = cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    doubled = np.linalg.norm(crosses, axis=1)
    level = crosses[:, 2] > 0.98 * doubled
    return triangles[:, :, 2].mean(axis=1), np.where(level, doubled / 2, 0.0)


def lowest_level(triangles: Floats, height: float, tolerance_m: float) -> tuple[float | None, float]:
    """Returns the lowest level, upward-facing triangle near a height and the area of all of them.

    Args:
        triangles: (T, 3, 3) visible triangles, world metres.
        height: height, metres.
        tolerance_m: greatest distance from the height, metres.

    Returns:
        The height, metres, or `None` if there is no such triangle; and the area, square metres.
    """
    heights, areas = _facing_up(triangles)
    near = (areas > 0) & (np.abs(heights - height) <= tolerance_m)
    return (float(heights[near].min()) if near.any() else None), float(areas[near].sum())


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
            "that the floor is visible and faces up; add a floor to a file without one: "
            f"--floor {lowest_point(triangles):g}"
        )
    large = levels[per_level >= _MIN_SHARE * largest]
    lowest = large.min()
    for upper in large:  # the lower side of a slab faces up, too, if its faces are visible from both sides
        above, below = ((bins == level) & (areas > 0) for level in (upper, lowest))
        if 0 < upper - lowest <= _SLAB_BINS and _covers(triangles[above], triangles[below]):
            lowest = upper
    chosen = (bins == lowest) & (areas > 0)
    return round(float(np.average(heights[chosen], weights=areas[chosen])), 4)


def _covers(upper: Floats, lower: Floats) -> bool:
    """Returns whether level triangles have most of the area and of the extent in the plane of triangles below them."""
    if _facing_up(upper)[1].sum() < _COVERED_SHARE * _facing_up(lower)[1].sum():
        return False
    (a, b), (c, d) = (
        (corners.min(axis=0), corners.max(axis=0)) for corners in (upper.reshape(-1, 3), lower.reshape(-1, 3))
    )
    common = np.maximum(np.minimum(b, d) - np.maximum(a, c), 0.0)[:2].prod()
    return bool(common >= _COVERED_SHARE * (d - c)[:2].prod())


def lowest_point(triangles: Floats) -> float:
    """Returns the height of the lowest vertex of triangles (T, 3, 3), rounded to centimetres, without -0."""
    return round(float(triangles[..., 2].min()), 2) + 0.0


def find_missing_floor(triangles: Floats, height: float) -> str:
    """Returns a note if the floor is probably the top of furniture in a file without a ground, or an empty string.

    Args:
        triangles: (T, 3, 3) visible triangles, world metres.
        height: height of the floor, metres.
    """
    low, high = triangles[..., :2].min(axis=(0, 1)), triangles[..., :2].max(axis=(0, 1))
    heights, areas = _facing_up(triangles)
    area = float(areas[np.abs(heights - height) <= FLOOR_TOLERANCE_M].sum())
    covered, ground = float(np.prod(high - low)), lowest_point(triangles)
    if height - ground < _DEEP_M or area > _SMALL_SHARE * covered:
        return ""
    return (
        f"the floor at {height:.2f} m has {area:.3g} m2 of the {covered:.3g} m2 of the scene, which reaches down to "
        f"{ground:g} m: if the file has no ground, add one with --floor {ground:g}"
    )


_DEEP_M, _SMALL_SHARE = 0.1, 0.3
"""A floor is doubtful if the scene extends this deep below it, and it covers less than this share of the scene."""


def floor_triangles(triangles: Floats, height: float) -> Floats:
    """Returns the floor triangles (F, 3, 3) for a height of the floor."""
    heights, areas = _facing_up(triangles)
    return triangles[(areas > 0) & (np.abs(heights - height) <= FLOOR_TOLERANCE_M)]
