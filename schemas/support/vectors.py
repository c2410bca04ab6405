"""Vectors in space. Pure functions."""

from __future__ import annotations

import numpy as np

from schemas.support.numpy_types import Floats


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
