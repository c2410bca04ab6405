"""Sine, cosine, arctangent, products and solutions that give the same bits on every processor of a cluster.

numpy has several kernels of sine and cosine, and BLAS, which `@`, `np.dot`, `np.linalg.solve` and the norm of a single
vector call, has several of the product; both pick one by the processor, and they differ in the last bit. What is
written to an episode or a scene is computed without them.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from schemas.support.numpy_types import Floats

__all__ = ["arctan2", "cos", "product", "sin", "solve"]


def sin(angles: Floats) -> Floats:
    """Returns the sines of an array of any shape, radians, by the C library."""
    return _each(math.sin, angles)


def cos(angles: Floats) -> Floats:
    """Returns the cosines of an array of any shape, radians, by the C library."""
    return _each(math.cos, angles)


def arctan2(y: Floats, x: Floats) -> Floats:
    """Returns the angles, radians, of points whose coordinates are two arrays of one shape, by the C library."""
    return _each(math.atan2, y, x)


def product(left: Floats, right: Floats) -> Floats:
    """Returns the product (N, K) of matrices (N, M) and (M, K), M small, each sum in the order of M."""
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
