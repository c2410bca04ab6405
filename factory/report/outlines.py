"""Outlines of the regions of a grid, along the edges of its cells. Pure."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from numpy.typing import NDArray

__all__ = ["trace_outlines"]

Corner = tuple[int, int]


def trace_outlines(mask: NDArray[np.bool_]) -> list[NDArray[np.float64]]:
    """Returns closed loops around all regions of True cells, holes as loops of the other direction.

    Args:
        mask: (H, W).

    Returns:
        Loops of (K, 2) corners as column, row in cells; the last corner is joined to the first; straight runs have no
        corner inside.
    """
    following = _directed_edges(mask)
    loops = []
    while following:
        start = next(iter(following))
        loop, here = [start], _take(following, start)
        while here != start:
            loop.append(here)
            here = _take(following, here)
        loops.append(_without_straight_runs(np.array(loop, np.float64)))
    return loops


def _directed_edges(mask: NDArray[np.bool_]) -> dict[Corner, list[Corner]]:
    """Returns corner -> next corners, with the region to the left of the way (rows up)."""
    padded = np.pad(mask, 1)
    following: dict[Corner, list[Corner]] = defaultdict(list)
    below, here = padded[:-1, 1:-1], padded[1:, 1:-1]
    for row, column in np.argwhere(here & ~below).tolist():
        following[column, row].append((column + 1, row))
    for row, column in np.argwhere(below & ~here).tolist():
        following[column + 1, row].append((column, row))
    left, right = padded[1:-1, :-1], padded[1:-1, 1:]
    for row, column in np.argwhere(left & ~right).tolist():
        following[column, row].append((column, row + 1))
    for row, column in np.argwhere(right & ~left).tolist():
        following[column, row + 1].append((column, row))
    return following


def _take(following: dict[Corner, list[Corner]], corner: Corner) -> Corner:
    ends = following[corner]
    end = ends.pop()
    if not ends:
        del following[corner]
    return end


def _without_straight_runs(loop: NDArray[np.float64]) -> NDArray[np.float64]:
    before, after = loop - np.roll(loop, 1, axis=0), np.roll(loop, -1, axis=0) - loop
    corners: NDArray[np.float64] = loop[(before != after).any(axis=1)]
    return corners
