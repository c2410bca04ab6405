"""Finds points at given distances from targets on straight lines to their centres, for one target or many at once.

A target is a convex polygon with a centre inside it, or the centre alone. Pure functions. Arguments of many targets
have shapes that broadcast with the points; the results are bit-identical to those of separate calls for each target.
"""

from __future__ import annotations

import numpy as np

from schemas.support.geometry import gaps_to, polygon_distances, squares
from schemas.support.numpy_types import Floats

_STEP = 2.0**-36
"""Resolution of a point on a line, as a share of its length; below 1e-8 m on a line of 100 m."""
_NEWTON_STEPS = 6
"""Largest number of steps of Newton's method, which find nearly all points on lines; bisection finds the others."""


def target_distances(points: Floats, centre: Floats, vertices: Floats | None) -> Floats:
    """Returns the distances (...) of points (..., 2) to targets, metres.

    Args:
        points: world x, y, metres.
        centre: (2,) or (..., 2) centres, metres.
        vertices: polygons as in `polygon_distances`; `None` measures from the centres.
    """
    if vertices is not None:
        return polygon_distances(points, vertices)
    return np.asarray(np.linalg.norm(points - centre, axis=-1))


def approach(starts: Floats, limit: Floats, centre: Floats, vertices: Floats | None) -> Floats:
    """Returns the points (..., 2) at which straight lines from starts to the centres come within a distance.

    Returns a start itself if it is within that distance.

    Args:
        starts: (..., 2) points, metres.
        limit: distances (...), metres.
        centre: (2,) or (..., 2) centres, metres.
        vertices: polygons as in `polygon_distances`; `None` measures from the centres.
    """
    away = starts - centre
    if vertices is None:
        distance = np.linalg.norm(away, axis=-1, keepdims=True)
        nearer = centre + away * (limit[..., None] / np.maximum(distance, 1e-9))
        return np.where(distance > limit[..., None], nearer, starts)
    # the result equals that of a bisection to the last bit, because recorded episodes depend on these points; neither a
    # closed form nor a bisection with fewer steps does
    low, high = _bracket(away, limit, centre, vertices)
    while (is_wide := high - low > _STEP).any():
        middle = (low + high) / 2
        is_near = polygon_distances(centre + away * middle[..., None], vertices) <= limit
        low, high = np.where(is_wide & is_near, middle, low), np.where(is_wide & ~is_near, middle, high)
    is_there = (polygon_distances(starts, vertices) <= limit)[..., None]
    return np.where(is_there, starts, centre + away * low[..., None])


def _bracket(away: Floats, limit: Floats, centre: Floats, vertices: Floats) -> tuple[Floats, Floats]:
    """Returns two positions (...) on each line (..., 2) from a centre, between which it crosses a distance (...).

    A position is a share of the line and a multiple of `_STEP`. The positions differ by `2 * _STEP` if Newton's method
    found the crossing, else they are 0 and 1; bisection gives the same point in both cases. The distance is a convex
    function of the position, so Newton's method cannot pass the crossing.
    """
    share = np.ones(away.shape[:-1])
    for _ in range(_NEWTON_STEPS):
        gaps = gaps_to(centre + away * share[..., None], vertices)
        distance = np.sqrt(squares(gaps))
        slope = -(gaps[..., 0] * away[..., 0] + gaps[..., 1] * away[..., 1]) / np.maximum(distance, 1e-9)
        step = (distance - limit) / np.maximum(slope, 1e-9)
        before, share = share, np.minimum(np.maximum(share - step, 0.0), 1.0)
        if (np.abs(share - before) < _STEP / 4).all():
            break
    rounded = np.round(share / _STEP) * _STEP
    low, high = np.maximum(rounded - _STEP, 0.0), np.minimum(rounded + _STEP, 1.0)
    is_low = polygon_distances(centre + away * low[..., None], vertices) <= limit
    is_high = (polygon_distances(centre + away * high[..., None], vertices) > limit) | (high == 1.0)
    return np.where(is_low & is_high, low, 0.0), np.where(is_low & is_high, high, 1.0)


def ring(directions: Floats, distance: Floats, centre: Floats, extent: Floats, vertices: Floats | None) -> Floats:
    """Returns the points (..., N, 2) at given distances from targets, on rays from their centres.

    Args:
        directions: (N, 2) unit vectors.
        distance: one distance, or one for each direction (N,), metres.
        centre: (2,) or (..., 1, 2) centres, metres.
        extent: largest distance of a vertex from the centre, a scalar or (..., 1), metres.
        vertices: polygons as in `polygon_distances`; `None` measures from the centres.
    """
    if vertices is None:
        return np.asarray(centre + distance[..., None] * directions)
    return approach(centre + (extent + distance)[..., None] * directions, distance, centre, vertices)
