"""Computes the light of each texel: ambient light with occlusion, and lamp light with shadows. Deterministic.

Texels of flat charts cast few rays, different for neighbours, which are averaged later. Texels of curved charts cast
more rays, the same for all, so that the light is smooth over small charts.
"""

from __future__ import annotations

import numpy as np

from factory.scenes.light.charts import number_rows
from factory.scenes.light.lamps import Lamps, light_from, nearest_lamps
from factory.scenes.light.rays import Caster
from factory.scenes.light.texels import PATTERN_SIDE, Texels
from schemas.support import portable
from schemas.support.numpy_types import Bools, Floats, Ints, Singles

__all__ = ["Rays", "lamp_light", "sky_light"]

_REACH_M = 1.6
_CELL_M = 2.5
_LAMPS_A_CELL = 24
_HIDDEN_SHARE = 0.35
_CHUNK = 1 << 13
"""Number of texels per batch; the working set of a batch fits the processor cache."""

Rays = tuple[int, int]
"""Number of rays of a texel on a flat chart and on a curved chart."""


def _sequence(count: int) -> Floats:
    """Returns nine low-discrepancy sequences (9, count, 2), 0..1: interleaved R2 (plastic number) sequences."""
    steps = np.arange(1, count * PATTERN_SIDE**2 + 1)[:, None] * (0.7548776662466927, 0.5698402909980532)
    return np.asarray((steps % 1.0).reshape(count, PATTERN_SIDE**2, 2).swapaxes(0, 1))


def sky_light(caster: Caster, texels: Texels, rays: Rays) -> tuple[Floats, Bools]:
    """Returns (N,) the openness of the half-space above each texel, 0..1, and whether the texel is inside a solid."""
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
    """Returns (N,) the unoccluded light of the lamps at each texel, and the share that is visible."""
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
    """Samples lamps by their unoccluded light, and points on them, and tests visibility."""
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
