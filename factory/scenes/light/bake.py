"""Bakes the light of a scene into a map: ambient occlusion, and lamps with soft shadows; same scene, same bytes.

A coarse look first finds the pieces that are hidden or in the dark, so that the fine one spends its texels elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from factory.scenes.light.charts import Charts, find_charts
from factory.scenes.light.contact import contact_shade
from factory.scenes.light.curves import Bends, find_bends
from factory.scenes.light.lamps import Lamps, find_lamps
from factory.scenes.light.rays import Caster
from factory.scenes.light.shine import lamp_light, sky_light
from factory.scenes.light.smooth import fill_hidden, smooth_charts
from factory.scenes.light.texels import Texels, lay_texels
from factory.scenes.light.tone import tone
from factory.scenes.light.unwrap import Unwrap, unwrap

__all__ = ["LightMap", "bake_light"]

_COARSE = 0.25
_COARSE_SKY, _COARSE_LAMPS = (5, 5), (2, 2)
_FINE_SKY, _FINE_LAMPS = (14, 27), (8, 12)
_HIDDEN_GAIN, _DARK_GAIN = 0.0, 0.4
"""Density of texels on pieces that are within something solid, and on pieces that no lamp reaches."""
_MIDDLE_GREY = 0.5
"""Reflectance that needs no correction of the exposure."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class LightMap:
    """Baked light."""

    uvs: NDArray[np.float32]
    """(T, 3, 2) place of each corner in the picture, 0..1."""
    picture: NDArray[np.uint8]
    """(H, W, 3) gamma-encoded, 255 is full light."""


def bake_light(
    triangles: Floats, groups: Ints, brightness: Floats, floor_m: float, reflectance: Floats | None = None
) -> LightMap:
    """Bakes the light of a scene.

    Args:
        triangles: (T, 3, 3) what can be seen, world metres, counter-clockwise from outside.
        groups: (T,) the part of each; surfaces of different parts are never joined.
        brightness: (T,) how brightly each glows by itself; 0 for what only reflects.
        floor_m: height of the floor.
        reflectance: (T,) luminance 0..1 of each surface in full light, for the exposure; middle grey when `None`.
    """
    charts = find_charts(triangles, groups)
    bends = find_bends(charts, triangles, groups)
    glow = np.zeros(len(charts.area))
    np.maximum.at(glow, charts.of_triangle, brightness)
    bounds = np.array((triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))))
    caster, lamps = Caster(triangles), find_lamps(charts, glow, bounds, floor_m)
    layout = unwrap(charts, _interest(caster, charts, bends, lamps), bends.least_texels())
    texels = lay_texels(charts, bends, layout)
    sky, hidden = sky_light(caster, texels, _FINE_SKY)
    whole, free = lamp_light(caster, texels, lamps, _FINE_LAMPS)
    shines = glow[texels.chart] > 0
    owner = np.full(layout.shape, -1, np.int64)
    owner[texels.cell] = texels.chart
    known, soft = _mask(layout, texels, ~hidden), _mask(layout, texels, ~texels.is_bent)
    spread = [_spread(values, texels, known, soft, owner) for values in (sky, free)]
    touch = contact_shade(triangles, floor_m, texels.points, texels.axes[:, 2])
    opening = spread[0] * fill_hidden(_map(layout, texels, touch), known, owner)
    gifts = fill_hidden(_map(layout, texels, whole), known, owner)
    grey = _chart_means(charts, reflectance)[texels.chart]
    shown = _mask(layout, texels, ~hidden & ~shines)
    picture = tone(opening, gifts * spread[1], shown, _map(layout, texels, grey))
    picture[_mask(layout, texels, shines)] = 255
    return LightMap(layout.uvs.astype(np.float32), picture)


def _interest(caster: Caster, charts: Charts, bends: Bends, lamps: Lamps) -> Floats:
    """(C,) how dense the texels of each chart should lie, by a coarse look: 1, or less for what is hidden or dark."""
    layout = unwrap(charts, np.full(len(charts.area), _COARSE))
    texels = lay_texels(charts, bends, layout)
    _, hidden = sky_light(caster, texels, _COARSE_SKY)
    whole, free = lamp_light(caster, texels, lamps, _COARSE_LAMPS)
    is_seen, is_lit = np.zeros(len(charts.area), bool), np.zeros(len(charts.area), bool)
    np.logical_or.at(is_seen, texels.chart, ~hidden)
    np.logical_or.at(is_lit, texels.chart, ~hidden & (whole * free > 0))
    return np.where(is_lit, 1.0, np.where(is_seen, _DARK_GAIN, _HIDDEN_GAIN))


def _chart_means(charts: Charts, reflectance: Floats | None) -> Floats:
    """(C,) the mean reflectance of each chart."""
    if reflectance is None:
        return np.full(len(charts.area), _MIDDLE_GREY)
    total = np.bincount(charts.of_triangle, reflectance)
    return np.asarray(total / np.bincount(charts.of_triangle))


def _spread(values: Floats, texels: Texels, known: Bools, soft: Bools, owner: Ints) -> Floats:
    """Lays values out as a map without holes, smooth within flat charts."""
    flat = np.zeros(owner.shape)
    flat[texels.cell] = values
    return fill_hidden(np.where(soft, smooth_charts(flat, known, owner), flat), known, owner)


def _map(layout: Unwrap, texels: Texels, values: Floats) -> Floats:
    flat = np.zeros(layout.shape)
    flat[texels.cell] = values
    return flat


def _mask(layout: Unwrap, texels: Texels, chosen: Bools) -> Bools:
    mask = np.zeros(layout.shape, bool)
    mask[texels.cell] = chosen
    return mask
