"""How much light reaches each texel: from everywhere past what is near, and from lamps past what stands between.

Flat texels cast few rays, and neighbours cast different ones, to be averaged later; bent ones cast more and the same,
so that light runs smoothly over small pieces. No chance is involved.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from factory.scenes.light.charts import number_rows
from factory.scenes.light.lamps import Lamps, light_from, nearest_lamps
from factory.scenes.light.rays import Caster
from factory.scenes.light.texels import PATTERN_SIDE, Texels

__all__ = ["Rays", "lamp_light", "sky_light"]

_REACH_M = 1.6
_CELL_M = 2.5
_LAMPS_A_CELL = 24
_HIDDEN_SHARE = 0.35
_CHUNK = 1 << 15

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Rays = tuple[int, int]
"""How many rays a flat and a bent texel cast."""


def _sequence(count: int) -> Floats:
    """Returns (9, count, 2) evenly spread numbers 0..1: the additive recurrence of the plastic number, dealt out."""
    steps = np.arange(1, count * PATTERN_SIDE**2 + 1)[:, None] * (0.7548776662466927, 0.5698402909980532)
    return np.asarray((steps % 1.0).reshape(count, PATTERN_SIDE**2, 2).swapaxes(0, 1))


def sky_light(caster: Caster, texels: Texels, rays: Rays) -> tuple[Floats, Bools]:
    """Returns (N,) how open the half-space over each texel is, 0..1, and whether it lies within something solid."""
    opening, hidden = np.zeros(len(texels.chart)), np.zeros(len(texels.chart), bool)
    for is_bent, count in zip((False, True), rays, strict=True):
        rows = np.flatnonzero(texels.is_bent == is_bent)
        for first in range(0, len(rows), _CHUNK):
            run = rows[first : first + _CHUNK]
            opening[run], hidden[run] = _sky(caster, texels.chosen(run), count)
    return opening, hidden


def _sky(caster: Caster, texels: Texels, count: int) -> tuple[Floats, Bools]:
    numbers = _sequence(count)
    radius, turn = np.sqrt(numbers[..., 0]), 2 * np.pi * numbers[..., 1]
    local = np.stack((radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - numbers[..., 0])), axis=-1)
    opening, backs = np.zeros(len(texels.chart)), np.zeros(len(texels.chart))
    for ray in range(count):
        way = np.einsum("nk,nkc->nc", local[texels.pattern, ray], texels.axes)
        distance, met_back = caster.first_hits(texels.points, way, _REACH_M)
        opening += np.where(met_back, 0.0, distance)
        backs += met_back
    return opening / (_REACH_M * count), backs > _HIDDEN_SHARE * count


def lamp_light(caster: Caster, texels: Texels, lamps: Lamps, rays: Rays) -> tuple[Floats, Floats]:
    """Returns (N,) the light that lamps would throw on each texel were nothing between, and the share that arrives."""
    cells = np.column_stack((np.floor(texels.points / _CELL_M), texels.is_bent))
    cell = number_rows(cells.astype(np.int64))
    order = np.argsort(cell, kind="stable")
    ends = np.flatnonzero(np.diff(cell[order])) + 1
    whole, free = np.zeros(len(order)), np.ones(len(order))
    for rows in np.split(order, ends):
        near = nearest_lamps(lamps, texels.points[rows].mean(axis=0), _LAMPS_A_CELL)
        count = rays[int(texels.is_bent[rows[0]])]
        for first in range(0, len(rows), _CHUNK):
            run = rows[first : first + _CHUNK]
            whole[run], free[run] = _lit(caster, texels.chosen(run), near, count)
    return whole, free


def _lit(caster: Caster, texels: Texels, lamps: Lamps, count: int) -> tuple[Floats, Floats]:
    """Chooses lamps by what they would give, and points on them, and looks whether the way there is free."""
    gifts = light_from(lamps, texels.points, texels.axes[:, 2]).cumsum(axis=1)
    whole = gifts[:, -1]
    free = np.zeros(len(whole))
    rows = np.flatnonzero(whole > 1e-6)
    if not len(rows):
        return whole, free
    pattern, points, reached = texels.pattern[rows], texels.points[rows], gifts[rows]
    numbers = _sequence(count)[pattern]
    shift = (pattern + 0.5) / PATTERN_SIDE**2
    met = np.zeros(len(rows))
    for ray in range(count):
        wanted = whole[rows] * (ray + shift) / count
        lamp = np.minimum((reached < wanted[:, None]).sum(axis=1), len(lamps.power) - 1)
        spot = lamps.corner[lamp] + np.einsum("nk,nkc->nc", numbers[:, ray], lamps.sides[lamp])
        way = spot + 0.01 * lamps.normal[lamp] - points
        length = np.maximum(np.linalg.norm(way, axis=1), 1e-6)
        met += caster.is_free(points, way / length[:, None], length)
    free[rows] = met / count
    return whole, free
