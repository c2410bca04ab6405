"""Averages and completes values in a light map without ever mixing two charts; pure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["fill_hidden", "smooth_charts"]

_FILL_ROUNDS = 12

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]


def smooth_charts(values: Floats, known: Bools, owner: Ints) -> Floats:
    """Returns each value averaged with the known ones around it, three by three, of the same chart.

    Args:
        values: (H, W).
        known: (H, W) which of them count.
        owner: (H, W) chart of each texel, -1 for none.
    """
    total, count = _around(values, known, owner)
    return np.where(count > 0, total / np.maximum(count, 1), values)


def fill_hidden(values: Floats, known: Bools, owner: Ints) -> Floats:
    """Returns the values with the unknown ones taken from their nearest known neighbours, else from the whole chart."""
    filled, have = values.copy(), known.copy()
    for _ in range(_FILL_ROUNDS):
        missing = ~have & (owner >= 0)
        if not missing.any():
            return filled
        total, count = _around(filled, have, owner)
        fresh = missing & (count > 0)
        filled[fresh] = total[fresh] / count[fresh]
        have |= fresh
    missing = ~have & (owner >= 0)
    means = _means(values, known, owner)
    filled[missing] = means[owner[missing]]
    return filled


def _means(values: Floats, known: Bools, owner: Ints) -> Floats:
    size = int(owner.max(initial=0)) + 1
    total = np.bincount(owner[known], values[known], size)
    count = np.bincount(owner[known], minlength=size)
    overall = float(values[known].mean()) if known.any() else 1.0
    return np.where(count > 0, total / np.maximum(count, 1), 0.3 * overall)


def _around(values: Floats, known: Bools, owner: Ints) -> tuple[Floats, Floats]:
    """Sum and number of the known values of the same chart in the square around each texel."""
    total, count = np.zeros(values.shape), np.zeros(values.shape)
    rows, columns = values.shape
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            here = (_run(down, rows), _run(right, columns))
            there = (_run(-down, rows), _run(-right, columns))
            same = known[there] & (owner[there] == owner[here])
            total[here] += np.where(same, values[there], 0.0)
            count[here] += same
    return total, count


def _run(shift: int, length: int) -> slice:
    """The indices of an axis whose neighbour `-shift` away exists."""
    return slice(max(shift, 0), length + min(shift, 0))
