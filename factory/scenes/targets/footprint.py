"""Computes the footprint of an object: the convex hull of its projection to the floor. Pure functions.

Vertices are rounded to tenths of a millimetre before the hull is computed with integers, so the result does not
depend on the machine.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from schemas.scene import Footprint
from schemas.support.numpy_types import Floats

_PER_METRE = 10_000
_MOST_VERTICES = 64

Vertex = tuple[int, int]


def footprint_of(triangles: Floats) -> Footprint:
    """Returns the vertices of the convex hull in the plane, counter-clockwise, metres.

    If there are more than 64 vertices, those that contribute the least area are removed. This makes the hull of a
    circle with a radius of 1 m at most 1.2 mm smaller.

    Args:
        triangles: (T, 3, 3) corners of the object, world metres.
    """
    plan = np.unique(np.rint(triangles.reshape(-1, 3)[:, :2] * _PER_METRE).astype(np.int64), axis=0)
    first = np.flatnonzero(np.diff(plan[:, 0], prepend=plan[0, 0] - 1))  # sorted by x, then by y
    last = np.append(first[1:], len(plan)) - 1
    ends = [(int(x), int(y)) for x, y in plan[np.unique(np.concatenate([first, last]))]]
    hull = _half(ends) + _half(reversed(ends)) if len(ends) > 1 else ends
    return tuple((x / _PER_METRE, y / _PER_METRE) for x, y in _reduced(hull))


def _half(points: Iterable[Vertex]) -> list[Vertex]:
    """Returns one half of the hull of sorted points without its last vertex (Andrew's monotone chain)."""
    chain: list[Vertex] = []
    for point in points:
        while len(chain) > 1 and _twice_area(chain[-2], chain[-1], point) <= 0:
            chain.pop()
        chain.append(point)
    return chain[:-1]


def _twice_area(a: Vertex, b: Vertex, c: Vertex) -> int:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _reduced(hull: list[Vertex]) -> list[Vertex]:
    while len(hull) > _MOST_VERTICES:
        areas = [_twice_area(hull[k - 1], hull[k], hull[(k + 1) % len(hull)]) for k in range(len(hull))]
        del hull[areas.index(min(areas))]
    return hull
