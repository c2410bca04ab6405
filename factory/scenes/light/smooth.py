"""Smooths and fills values of a light map within each chart. Pure functions. Does not mix charts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from schemas.support.numpy_types import Bools, Floats, Ints

_FILL_ROUNDS = 12
_NOISE = 0.12
"""Values that differ by at least this are not averaged; smaller differences are noise, caused by few rays."""


def smooth_charts(values: Floats, known: Bools, owner: Ints) -> tuple[Floats, Bools]:
    """Averages each value with the known values of the same chart in its 3 x 3 neighbourhood.

    Args:
        values: (..., H, W) maps.
        known: (H, W) validity mask.
        owner: (H, W) chart of each texel, or -1.

    Returns:
        The averages, and (H, W) the mask of texels with a known neighbour.
    """
    total, count = _around(values, known, owner)
    return np.where(count > 0, total / np.maximum(count, 1), values), count > 0


def even_out(values: Floats, known: Bools, owner: Ints, step: int) -> Floats:
    """Averages values (K, H, W) of texels of one chart that are `step` texels apart and differ by noise only.

    One pass of an edge-avoiding a-trous wavelet (Dammertz et al., HPG 2010). The weight of a neighbour falls to 0 where
    any of its values differs by `_NOISE`.
    """
    total, weight = 4.0 * values * known, 4.0 * known
    rows, columns = owner.shape
    for down in (-step, 0, step):
        for right in (-step, 0, step):
            here = (_run(down, rows), _run(right, columns))
            there = (_run(-down, rows), _run(-right, columns))
            if down or right:
                near = known[here] & known[there] & (owner[there] == owner[here])
                gap = (values[(..., *there)] - values[(..., *here)]) / _NOISE
                alike = near * (np.maximum(1.0 - gap * gap, 0.0) ** 2).prod(axis=0) * (1.0 if down and right else 2.0)
                total[(..., *here)] += alike * values[(..., *there)]
                weight[here] += alike
    return np.where(known, total / np.maximum(weight, 1e-9), values)


def fill_hidden(values: Floats, known: Bools, owner: Ints) -> Floats:
    """Returns the values (..., H, W). Unknown values are filled from their nearest known neighbours in the chart or, if
    there are none within `_FILL_ROUNDS` texels, with the mean of the chart."""
    filled, have = values.copy(), known.copy()
    missing = np.nonzero(~have & (owner >= 0))
    means, is_found = _means(values, known, owner)
    filled[..., missing[0], missing[1]] = means[..., owner[missing]]
    near = is_found[owner[missing]]  # a chart without a known texel keeps the value of `_means`
    missing = missing[0][near], missing[1][near]
    for _ in range(_FILL_ROUNDS):
        if not len(missing[0]):
            break
        total, count = _near(filled, have, owner, missing)
        fresh = count > 0
        rows, columns = missing[0][fresh], missing[1][fresh]
        filled[..., rows, columns] = total[..., fresh] / count[fresh]
        have[rows, columns] = True
        missing = missing[0][~fresh], missing[1][~fresh]
    return filled


def _near(values: Floats, known: Bools, owner: Ints, cells: tuple[NDArray[np.intp], ...]) -> tuple[Floats, Floats]:
    """Returns the sum and number of the known values of the same chart around the given cells."""
    count = np.zeros(len(cells[0]))
    total = np.zeros((*values.shape[:-2], len(count)))
    own = owner[cells]
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            rows, columns = cells[0] + down, cells[1] + right
            inside = (rows >= 0) & (rows < owner.shape[0]) & (columns >= 0) & (columns < owner.shape[1])
            rows, columns = np.where(inside, rows, 0), np.where(inside, columns, 0)
            same = inside & known[rows, columns] & (owner[rows, columns] == own)
            total += np.where(same, values[..., rows, columns], 0.0)
            count += same
    return total, count


def _means(values: Floats, known: Bools, owner: Ints) -> tuple[Floats, Bools]:
    """Returns the mean of the known values per chart (..., C), and the mask (C,) of charts with known values.

    A chart without known values gets 0.3 times the mean of all known values.
    """
    size = int(owner.max(initial=0)) + 1
    count = np.bincount(owner[known], minlength=size)
    maps = values.reshape(-1, *values.shape[-2:])
    total = np.stack([np.bincount(owner[known], each[known], size) for each in maps])
    overall = np.array([float(each[known].mean()) if known.any() else 1.0 for each in maps])
    means = np.where(count > 0, total / np.maximum(count, 1), 0.3 * overall[:, None])
    return means.reshape(*values.shape[:-2], size), count > 0


def _around(values: Floats, known: Bools, owner: Ints) -> tuple[Floats, Floats]:
    """Returns the sum and number of the known values of the same chart in the 3 x 3 square around each texel."""
    total, count = np.zeros(values.shape), np.zeros(owner.shape)
    rows, columns = owner.shape
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            here = (_run(down, rows), _run(right, columns))
            there = (_run(-down, rows), _run(-right, columns))
            same = known[there] & (owner[there] == owner[here])
            total[(..., *here)] += np.where(same, values[(..., *there)], 0.0)
            count[here] += same
    return total, count


def _run(shift: int, length: int) -> slice:
    """Returns the slice of indices of an axis whose neighbour at `-shift` exists."""
    return slice(max(shift, 0), length + min(shift, 0))
