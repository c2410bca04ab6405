"""Smooths and fills values of a light map within each chart, and tone-maps light to image values. Pure functions.

The tone curve (exposure by content, soft shoulder, warm and cool white) applies to the light map alone, so rendering is
one multiplication and cannot overflow.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from schemas.support.numpy_types import Bools, Floats, Ints

SKY_SHARE, FLOOR = 0.42, 0.03
CONTACT = 2.0
"""Exponent of the openness in ambient light; above 1, corners and floor under furniture are darker than is physically
correct."""
SHELTER = 0.6
"""Exponent of the openness in lamp light, where the openness adds soft contact shadows."""
_EXPOSURE = 1.3
"""Mean light before the tone curve, for a scene whose exposure is not corrected; in the unit of `WHITE`."""
_GREY, _ADAPTATION = 0.38, 0.6
"""`_GREY` is the mean reflectance of a scene whose exposure is not corrected. For other scenes, the exposure is
multiplied by (`_GREY` / mean reflectance) to the power of `_ADAPTATION`, within limits."""
_MOST_CORRECTION = 1.35
WHITE = 3.0
"""Light that the tone curve maps to 1; brighter light is clipped."""
_LAMP_TINT = np.array((1.0, 0.965, 0.885))
_SKY_TINT = np.array((0.94, 0.975, 1.0))
GAMMA = 2.2


def tone(sky: Floats, direct: Floats, measured: NDArray[np.bool_], grey: Floats) -> NDArray[np.uint8]:
    """Returns the gamma-encoded light map (H, W, 3).

    Args:
        sky: (H, W) openness, 0..1.
        direct: (H, W) lamp light, any unit.
        measured: (H, W) mask of the texels that determine the exposure.
        grey: (H, W) reflectance of the surface, 0..1.
    """
    lit = measured & (direct > 0)
    mean = float(direct[lit].mean()) if lit.any() else 1.0
    open_, lamps = sky, direct / mean
    ambient = FLOOR + SKY_SHARE * open_[..., None] ** CONTACT * _SKY_TINT
    light = ambient + (1 - SKY_SHARE) * (lamps * open_**SHELTER)[..., None] * _LAMP_TINT
    exposed = float(light[lit].mean()) if lit.any() else 1.0
    scale = _EXPOSURE * _correction(grey[lit]) / exposed
    bright = np.minimum(light * scale, WHITE)
    shown = bright * (1 + bright / WHITE**2) / (1 + bright)
    return np.asarray(np.rint(255 * shown ** (1 / GAMMA)), np.uint8)


def _correction(grey: Floats) -> float:
    """Returns the exposure factor: above 1 for dark scenes, below 1 for light ones."""
    if not len(grey):
        return 1.0
    # light that is scaled to the same mean in all scenes overexposes scenes with white surfaces
    wanted = (_GREY / max(float(grey.mean()), 1e-3)) ** _ADAPTATION
    return float(np.clip(wanted, 1 / _MOST_CORRECTION, _MOST_CORRECTION))


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
    cell_owner = owner[cells]
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            rows, columns = cells[0] + down, cells[1] + right
            inside = (rows >= 0) & (rows < owner.shape[0]) & (columns >= 0) & (columns < owner.shape[1])
            rows, columns = np.where(inside, rows, 0), np.where(inside, columns, 0)
            same = inside & known[rows, columns] & (owner[rows, columns] == cell_owner)
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
