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
from schemas.support import portable

__all__ = ["Rays", "lamp_light", "sky_light"]

_REACH_M = 1.6
_CELL_M = 2.5
_LAMPS_A_CELL = 24
_HIDDEN_SHARE = 0.35
_CHUNK = 1 << 13
"""Texels at a time: what is held for each of them stays in the processor's cache."""

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
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
            opening[run], hidden[run] = _sky(caster, texels, run, count)
    return opening, hidden


def _sky(caster: Caster, texels: Texels, run: Ints, count: int) -> tuple[Singles, Bools]:
    numbers = _sequence(count)
    radius, turn = np.sqrt(numbers[..., 0]), 2 * np.pi * numbers[..., 1]
    local = (radius * portable.cos(turn), radius * portable.sin(turn), np.sqrt(1 - numbers[..., 0]))
    patterns = [np.asarray(part, np.float32) for part in local]
    axes = np.ascontiguousarray(texels.axes[run].transpose(1, 2, 0), np.float32)
    points, pattern = np.ascontiguousarray(texels.points[run], np.float32), texels.pattern[run]
    opening, backs, way = np.zeros(len(run), np.float32), np.zeros(len(run), np.int64), np.empty_like(points)
    for ray in range(count):
        along, across, up = (part[:, ray].take(pattern) for part in patterns)
        for k in range(3):
            way[:, k] = along * axes[0, k] + across * axes[1, k] + up * axes[2, k]
        distance, met_back = caster.first_hits(points, way, _REACH_M)
        opening += np.where(met_back, np.float32(0), distance)
        backs += met_back
    return opening / np.float32(_REACH_M * count), backs > _HIDDEN_SHARE * count


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
            whole[run], free[run] = _lit(caster, texels, run, near, count)
    return whole, free


def _lit(caster: Caster, texels: Texels, run: Ints, lamps: Lamps, count: int) -> tuple[Singles, Singles]:
    """Chooses lamps by what they would give, and points on them, and looks whether the way there is free."""
    points, normals = (
        np.ascontiguousarray(values.T, np.float32) for values in (texels.points[run], texels.axes[run, 2])
    )
    reached = light_from(lamps, points, normals).cumsum(axis=0)
    whole, free = reached[-1], np.zeros(len(run), np.float32)
    rows = np.flatnonzero(whole > 1e-6)
    if not len(rows):
        return whole, free
    pattern, points, reached = texels.pattern[run[rows]], points[:, rows], reached[:, rows]
    numbers = np.asarray(_sequence(count), np.float32)
    shift = np.asarray((pattern + 0.5) / PATTERN_SIDE**2, np.float32)
    corner = np.asarray((lamps.corner + 0.01 * lamps.normal).T, np.float32)
    sides = np.asarray(lamps.sides.transpose(1, 2, 0), np.float32)
    origins, way, met = np.ascontiguousarray(points.T), np.empty((len(rows), 3), np.float32), np.zeros(len(rows))
    for ray in range(count):
        wanted = reached[-1] * ((ray + shift) / np.float32(count))
        lamp = np.minimum((reached < wanted).sum(axis=0, dtype=np.int16), len(lamps.power) - 1)
        along, across = (numbers[:, ray, side].take(pattern) for side in (0, 1))
        gap = [
            corner[k].take(lamp) + along * sides[0, k].take(lamp) + across * sides[1, k].take(lamp) - points[k]
            for k in range(3)
        ]
        length = np.maximum(np.sqrt(gap[0] * gap[0] + gap[1] * gap[1] + gap[2] * gap[2]), np.float32(1e-6))
        for k in range(3):
            way[:, k] = gap[k] / length
        met += caster.is_free(origins, way, length)
    free[rows] = met / count
    return whole, free
