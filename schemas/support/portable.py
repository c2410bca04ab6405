"""Sine, cosine, arctangent, matrix product and linear solver with bit-identical results on all processors.

numpy has several kernels for sine and cosine. `@`, `np.dot`, `np.linalg.solve` and the norm of a single vector use
BLAS, which has several kernels for the product. Both libraries select a kernel by processor, and the kernels differ in
the last bit. So values that are written to an episode or a scene are computed with this module instead.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from schemas.support.numpy_types import Floats


def sin(angles: Floats) -> Floats:
    """Returns the sines of angles in radians, an array of any shape, computed by the C library."""
    return _each(math.sin, angles)


def cos(angles: Floats) -> Floats:
    """Returns the cosines of angles in radians, an array of any shape, computed by the C library."""
    return _each(math.cos, angles)


def arctan2(y: Floats, x: Floats) -> Floats:
    """Returns the angles of points (x, y) in radians, for two arrays of one shape, computed by the C library."""
    return _each(math.atan2, y, x)


def product(left: Floats, right: Floats) -> Floats:
    """Returns the product (N, K) of matrices (N, M) and (M, K) for small M; sums run in the order of M."""
    return np.asarray((left[:, :, None] * right).sum(axis=1))


def solve(matrices: Floats, right: Floats) -> Floats:
    """Returns X (N, M, K) of A X = B for symmetric positive definite A (N, M, M) and B (N, M, K), by elimination."""
    rows, size = np.concatenate((matrices, right), axis=2), matrices.shape[1]
    for k in range(size):
        rows[:, k] /= rows[:, k, k, None]
        others = np.arange(size) != k
        rows[:, others] -= rows[:, others, k, None] * rows[:, None, k]
    return rows[:, :, size:]


def _each(function: Callable[..., float], *arguments: Floats) -> Floats:
    first = arguments[0]
    values = map(function, *(argument.ravel().tolist() for argument in arguments))
    return np.fromiter(values, np.float64, first.size).reshape(first.shape)
