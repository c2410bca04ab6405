"""Finds the pairs of objects with a wall on the straight line between their centres. Does not use room numbers."""

from __future__ import annotations

import numpy as np

from schemas.language.graph.rooms import CellGrid
from schemas.support.numpy_types import Bools, Floats

_WALL = 2
_FAR_M = 7.0
"""Distance between the middles of two objects beyond which no line is traced, metres."""
_END_M = 0.06
"""Width of a margin around both objects, metres; a wall within it does not count as a wall between them."""
_SAMPLES = 128
_CHUNK = 4096


def find_barriers(low: Floats, high: Floats, sight: CellGrid) -> Bools:
    """Returns the (N, N) pairs of objects with a wall between them, omitting pairs whose middles are 7 m or more apart.

    Args:
        low: (N, 2) lower corners of the bounding rectangles, metres.
        high: (N, 2) upper corners, metres.
        sight: grid with the value 2 in the cells of walls.
    """
    middle, found = (low + high) / 2, np.zeros((len(low), len(low)), bool)
    one, two = np.triu_indices(len(low), 1)
    near = np.hypot(*(middle[one] - middle[two]).T) < _FAR_M
    one, two = one[near], two[near]
    share = ((np.arange(_SAMPLES) + 0.5) / _SAMPLES)[:, None]
    for begin in range(0, len(one), _CHUNK):
        a, b = one[begin : begin + _CHUNK], two[begin : begin + _CHUNK]
        points = middle[a, None] + share * (middle[b] - middle[a])[:, None]
        wall = np.asarray(sight.at(points) == _WALL)
        for end in (a, b):
            inside = (points > low[end, None] - _END_M) & (points < high[end, None] + _END_M)
            wall &= ~inside.all(axis=-1)
        found[a, b] = found[b, a] = wall.any(axis=1)
    return found
