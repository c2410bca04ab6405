"""Geometry in the plane and in space: headings of poses, distances to polygons, lengths of vectors. Pure functions."""

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
    return polygon_distances(np.asarray(points, float), np.asarray(footprint_m, float))


def polygon_distances(points: Floats, vertices: Floats) -> Floats:
    """Returns the distances (...) of points (..., 2) to convex polygons; 0 on and inside them.

    Args:
        points: world x, y, metres.
        vertices: (K, 2) vertices of one polygon, counter-clockwise, or (K, ..., 2) of a polygon for each point; a
            polygon with fewer vertices repeats its last one.
    """
    x, y, is_inside = _to_sides(points, vertices)
    return np.asarray(np.sqrt(np.where(is_inside, 0.0, (x * x + y * y).min(axis=0))))


def gaps_to(points: Floats, vertices: Floats) -> Floats:
    """Returns the shortest vectors (..., 2) from points to convex polygons as in `polygon_distances`; 0 inside them."""
    x, y, is_inside = _to_sides(points, vertices)
    nearest = (x * x + y * y).argmin(axis=0).reshape(-1)
    each = np.arange(nearest.size)
    gaps = [part.reshape(len(part), -1)[nearest, each].reshape(is_inside.shape) for part in (x, y)]
    return np.where(is_inside[..., None], 0.0, np.stack(gaps, axis=-1))


def _to_sides(points: Floats, vertices: Floats) -> tuple[Floats, Floats, Bools]:
    """Returns x and y (K, ...) of the vectors from points (..., 2) to the sides of convex polygons, and whether each
    point is inside. The first axis counts the sides, because reductions over a short last axis are slow.
    """
    if vertices.ndim == 2:
        vertices = vertices.reshape(len(vertices), *(1,) * (points.ndim - 1), 2)
    sides = np.concatenate((vertices[1:], vertices[:1])) - vertices
    side_x, side_y, lengths = sides[..., 0], sides[..., 1], squares(sides)
    x, y = (vertices[..., k] - points[None, ..., k] for k in (0, 1))
    is_inside = np.asarray((side_y * x - side_x * y >= 0).all(axis=0))
    is_area = (lengths > 0).sum(axis=0) > 2  # a line has no inside
    along = -(x * side_x + y * side_y) / np.where(lengths > 0, lengths, 1.0)
    along = np.minimum(np.maximum(along, 0.0), 1.0)
    return x + along * side_x, y + along * side_y, is_inside & is_area


def squares(vectors: Floats) -> Floats:
    """Returns the squared lengths (...) of vectors (..., 2)."""
    return np.asarray(vectors[..., 0] * vectors[..., 0] + vectors[..., 1] * vectors[..., 1])


def cross(left: Floats, right: Floats) -> Floats:
    """Returns the vector products (..., 3) of vectors (..., 3), bit-identical to `numpy.cross` and, for few
    vectors, in a tenth of its time."""
    x, y, z = left[..., 0], left[..., 1], left[..., 2]
    other_x, other_y, other_z = right[..., 0], right[..., 1], right[..., 2]
    product = np.empty(np.broadcast_shapes(left.shape, right.shape), np.result_type(left, right))
    product[..., 0] = y * other_z - z * other_y
    product[..., 1] = z * other_x - x * other_z
    product[..., 2] = x * other_y - y * other_x
    return product
