"""Geometry in the plane and in space: headings of poses, distances to polygons, lengths of vectors. Pure functions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from schemas.support import portable
from schemas.support.numpy_types import Bools, Floats

STATE_NAMES = ("x_m", "y_m", "yaw_rad", "v_mps", "w_rps")
"""Names of the numbers in `observation.state` of exports and in `state` of the observations of policies."""


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


def planar_states(poses: NDArray[np.float64], hz: int) -> NDArray[np.float32]:
    """Returns the state (T, 5) of each frame, in the order of `STATE_NAMES`; frame t depends on poses 0 to t only.

    x and y in metres (x forward, y left) and the unwrapped yaw in radians are those of base_link in the frame of the
    first pose. v in m/s and w in rad/s are measured over the step before the frame, and are 0 in the first frame.

    Args:
        poses: (T, 7) x, y, z, qw, qx, qy, qz of base_link in the world frame.
        hz: frames per second.
    """
    yaw = np.unwrap(yaw_of(poses))
    offset = poses[:, :2] - poses[0, :2]
    cos, sin = np.cos(yaw[0]), np.sin(yaw[0])
    x, y = cos * offset[:, 0] + sin * offset[:, 1], cos * offset[:, 1] - sin * offset[:, 0]
    turned = yaw - yaw[0]
    heading = (turned[1:] + turned[:-1]) / 2
    v, w = np.zeros(len(poses)), np.zeros(len(poses))
    v[1:] = (np.diff(x) * np.cos(heading) + np.diff(y) * np.sin(heading)) * hz
    w[1:] = np.diff(turned) * hz
    return np.stack([x, y, turned, v, w], axis=1).astype(np.float32)
