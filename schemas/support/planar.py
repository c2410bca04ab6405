"""Planar geometry: headings of poses, and distances to polygons. Pure functions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from schemas.support import portable
from schemas.support.numpy_types import Bools, Floats


def yaw_of(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the headings (T,) of poses (T, 7) x, y, z, qw, qx, qy, qz, radians."""
    w, x, y, z = poses[:, 3:].T
    return portable.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def footprint_distances(points: ArrayLike, footprint_m: Sequence[tuple[float, float]]) -> Floats:
    """Returns the planar distances (...) of points (..., 2) to a convex polygon; 0 on and inside it, metres.

    Args:
        points: world x, y, metres.
        footprint_m: vertices of the polygon, counter-clockwise; at least one.
    """
    to_sides, is_inside = _to_sides(np.asarray(points, float), np.asarray(footprint_m, float))
    return np.asarray(np.sqrt(np.where(is_inside, 0.0, squares(to_sides).min(axis=-1))))


def gaps_to(points: Floats, vertices: Floats) -> Floats:
    """Returns the shortest vectors (..., 2) from points (..., 2) to a convex polygon (K, 2); 0 on and inside it."""
    to_sides, is_inside = _to_sides(points, vertices)
    nearest = squares(to_sides).argmin(axis=-1)[..., None, None]
    return np.where(is_inside[..., None], 0.0, np.take_along_axis(to_sides, nearest, axis=-2)[..., 0, :])


def _to_sides(points: Floats, vertices: Floats) -> tuple[Floats, Bools]:
    """Returns vectors (..., K, 2) from points (..., 2) to the sides of a convex polygon, and whether each is inside."""
    sides = np.concatenate((vertices[1:], vertices[:1])) - vertices
    to_vertex = vertices - points[..., None, :]
    lengths = squares(sides)
    along = -(to_vertex[..., 0] * sides[:, 0] + to_vertex[..., 1] * sides[:, 1]) / np.where(lengths > 0, lengths, 1.0)
    to_sides = to_vertex + np.clip(along, 0.0, 1.0)[..., None] * sides
    is_left = sides[:, 1] * to_vertex[..., 0] - sides[:, 0] * to_vertex[..., 1] >= 0
    return to_sides, np.asarray(is_left.all(axis=-1)) & (len(vertices) > 2)


def squares(vectors: Floats) -> Floats:
    """Returns the squared lengths (...) of vectors (..., 2)."""
    return np.asarray(vectors[..., 0] * vectors[..., 0] + vectors[..., 1] * vectors[..., 1])
