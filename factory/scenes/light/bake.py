"""Bakes the light of a scene into a map: ambient occlusion, and lamps with soft shadows; same scene, same bytes.

Every texel casts few rays, and neighbours cast different ones: texels share nine patterns of directions in squares of
three by three, and averaging over such a square inside a chart gives each the rays of all nine. No chance is involved.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from factory.scenes.light.charts import Charts, find_charts
from factory.scenes.light.lamps import Lamps, find_lamps, light_from, nearest_lamps
from factory.scenes.light.rays import Caster
from factory.scenes.light.smooth import fill_hidden, smooth_charts
from factory.scenes.light.tone import tone
from factory.scenes.light.unwrap import Unwrap, unwrap

__all__ = ["LightMap", "bake_light"]

_SKY_RAYS, _LAMP_RAYS, _SIDE = 14, 8, 3
_REACH_M = 1.6
_LIFT_M = 0.006
_CELL_M = 2.5
_LAMPS_A_CELL = 24
_HIDDEN_SHARE = 0.35
_CHUNK = 1 << 15

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class LightMap:
    """Baked light."""

    uvs: NDArray[np.float32]
    """(T, 3, 2) place of each corner in the picture, 0..1."""
    picture: NDArray[np.uint8]
    """(H, W, 3) gamma-encoded, 255 is full light."""


@dataclass(frozen=True)
class _Texels:
    """The texels that lie on surfaces, N of them."""

    cell: tuple[Ints, Ints]
    """Row and column in the map."""
    chart: Ints
    points: Floats
    """(N, 3) metres, just above the surface."""
    pattern: Ints
    """(N,) which of the nine sets of rays."""


def bake_light(triangles: Floats, groups: Ints, brightness: Floats, floor_m: float) -> LightMap:
    """Bakes the light of a scene.

    Args:
        triangles: (T, 3, 3) what can be seen, world metres, counter-clockwise from outside.
        groups: (T,) the part of each; surfaces of different parts are never joined.
        brightness: (T,) how brightly each glows by itself; 0 for what only reflects.
        floor_m: height of the floor.
    """
    charts = find_charts(triangles, groups)
    layout = unwrap(charts)
    texels = _texels(charts, layout)
    glow = np.zeros(len(charts.area))
    np.maximum.at(glow, charts.of_triangle, brightness)
    bounds = np.array((triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))))
    caster = Caster(triangles)
    sky, hidden = _sky(caster, charts, texels)
    direct = _direct(caster, charts, texels, find_lamps(charts, glow, bounds, floor_m))
    shines = glow[texels.chart] > 0
    owner = np.full(layout.shape, -1, np.int64)
    owner[texels.cell] = texels.chart
    known = _mask(layout, texels, ~hidden)
    spread = [_spread(values, texels, known, owner) for values in (sky, direct)]
    picture = tone(spread[0], spread[1], measured=_mask(layout, texels, ~hidden & ~shines))
    picture[_mask(layout, texels, shines)] = 255
    return LightMap(layout.uvs.astype(np.float32), picture)


def _spread(values: Floats, texels: _Texels, known: NDArray[np.bool_], owner: Ints) -> Floats:
    """Lays values out as a map, smooth within charts and without holes."""
    flat = np.zeros(owner.shape)
    flat[texels.cell] = values
    return fill_hidden(smooth_charts(flat, known, owner), known, owner)


def _mask(layout: Unwrap, texels: _Texels, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    mask = np.zeros(layout.shape, bool)
    mask[texels.cell] = chosen
    return mask


def _texels(charts: Charts, layout: Unwrap) -> _Texels:
    """Lays the texels of each chart over its rectangle, the outermost just inside its edges."""
    counts = layout.size.prod(axis=1)
    chart = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(len(chart)) - np.repeat(np.cumsum(counts) - counts, counts)
    wide = layout.size[chart, 0]
    local = np.column_stack((within % wide, within // wide))
    steps = np.maximum(layout.size[chart] - 1, 1)
    share = np.where(layout.size[chart] > 1, np.clip(local / steps, 0.15 / steps, 1 - 0.15 / steps), 0.5)
    metres = share * charts.extent[chart]
    axes = charts.axes[chart]
    points = charts.origin[chart] + metres[:, :1] * axes[:, 0] + metres[:, 1:] * axes[:, 1] + _LIFT_M * axes[:, 2]
    place = layout.place[chart] + local
    pattern = local[:, 0] % _SIDE + _SIDE * (local[:, 1] % _SIDE)
    return _Texels((place[:, 1], place[:, 0]), chart, points, pattern)


def _sequence(count: int) -> Floats:
    """Returns (9, count, 2) evenly spread numbers 0..1: the additive recurrence of the plastic number, dealt out."""
    steps = np.arange(1, count * _SIDE**2 + 1)[:, None] * (0.7548776662466927, 0.5698402909980532)
    return np.asarray((steps % 1.0).reshape(count, _SIDE**2, 2).swapaxes(0, 1))


def _sky(caster: Caster, charts: Charts, texels: _Texels) -> tuple[Floats, NDArray[np.bool_]]:
    """Returns how open the half-space over each texel is, 0..1, and whether the texel lies within something solid."""
    numbers = _sequence(_SKY_RAYS)
    radius, turn = np.sqrt(numbers[..., 0]), 2 * np.pi * numbers[..., 1]
    local = np.stack((radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - numbers[..., 0])), axis=-1)
    opening, backs = np.zeros(len(texels.chart)), np.zeros(len(texels.chart))
    for first in range(0, len(opening), _CHUNK):
        run = slice(first, first + _CHUNK)
        axes, points, pattern = charts.axes[texels.chart[run]], texels.points[run], texels.pattern[run]
        for ray in range(_SKY_RAYS):
            way = np.einsum("nk,nkc->nc", local[pattern, ray], axes)
            distance, met_back = caster.first_hits(points, way, _REACH_M)
            opening[run] += np.where(met_back, 0.0, distance)
            backs[run] += met_back
    return opening / (_REACH_M * _SKY_RAYS), backs > _HIDDEN_SHARE * _SKY_RAYS


def _direct(caster: Caster, charts: Charts, texels: _Texels, lamps: Lamps) -> Floats:
    """Returns the light that lamps throw on each texel past what stands between."""
    cells = np.floor(texels.points / _CELL_M).astype(np.int64)
    _, cell = np.unique(cells, axis=0, return_inverse=True)
    order = np.argsort(cell.reshape(-1), kind="stable")
    ends = np.flatnonzero(np.diff(cell.reshape(-1)[order])) + 1
    light = np.zeros(len(order))
    for rows in np.split(order, ends):
        middle = texels.points[rows].mean(axis=0)
        near = nearest_lamps(lamps, middle, _LAMPS_A_CELL)
        for first in range(0, len(rows), _CHUNK):
            run = rows[first : first + _CHUNK]
            light[run] = _lit(caster, texels.points[run], charts.axes[texels.chart[run], 2], texels.pattern[run], near)
    return light


def _lit(caster: Caster, points: Floats, normals: Floats, pattern: Ints, lamps: Lamps) -> Floats:
    """Chooses lamps by what they would give, and points on them, and looks whether the way there is free."""
    gifts = light_from(lamps, points, normals).cumsum(axis=1)
    whole = gifts[:, -1]
    rows = np.flatnonzero(whole > 1e-6)
    if not len(rows):
        return np.zeros(len(points))
    numbers = _sequence(_LAMP_RAYS)[pattern[rows]]
    shift = (np.arange(_SIDE**2)[pattern[rows]] + 0.5) / _SIDE**2
    free = np.zeros(len(rows))
    for ray in range(_LAMP_RAYS):
        wanted = whole[rows] * (ray + shift) / _LAMP_RAYS
        lamp = np.minimum((gifts[rows] < wanted[:, None]).sum(axis=1), len(lamps.power) - 1)
        spot = lamps.corner[lamp] + np.einsum("nk,nkc->nc", numbers[:, ray], lamps.sides[lamp])
        way = spot + 0.01 * lamps.normal[lamp] - points[rows]
        length = np.maximum(np.linalg.norm(way, axis=1), 1e-6)
        free += caster.is_free(points[rows], way / length[:, None], length)
    light = np.zeros(len(points))
    light[rows] = whole[rows] * free / _LAMP_RAYS
    return light
