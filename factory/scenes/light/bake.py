"""Bakes the light map of a scene: ambient occlusion, lamps with soft shadows, contact shadows. Deterministic.

A coarse pass finds hidden and dark charts, so the fine pass uses fewer texels for them.

Design: docs/design/rendering.md#light-is-baked-into-textures.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from factory.scenes.light.charts import Charts, find_charts, unwrap
from factory.scenes.light.curves import Bends, find_bends
from factory.scenes.light.irradiance import Lamps, Rays, find_lamps, lamp_light, sky_light
from factory.scenes.light.smooth import even_out, fill_hidden, smooth_charts, tone
from factory.scenes.light.texels import TexelGrid, Texels, lay_texels
from schemas.support.numpy_types import Bools, Floats, Ints
from workers.geometry.rays import Caster

_SECTION_M = 0.02
_STEP_M = 0.015
_NEAR_M = 0.03
"""Maximum vertical distance of a floor surface from the height of the floor, metres."""
_UP = 0.95
_FADE_M, _DEPTH = 0.065, 0.78
"""The light at a gap g from an object is reduced by the share `_DEPTH` exp(-g / `_FADE_M`): 78 % at the object, and
less than 1 % at `_REACH_M`."""
# no fit of these values to a reference is recorded
_REACH_M = 0.3
_MOST_SAMPLES = 4_000_000


def contact_shade(triangles: Floats, floor_m: float, points: Floats, normals: Floats) -> Floats:
    """Returns (N,) the light factor, 0..1, near objects on the floor; 1 for points that are not on the floor.

    Args:
        triangles: (T, 3, 3) triangles of the scene, world metres.
        floor_m: height of the floor, metres.
        points: (N, 3) surface points, world metres.
        normals: (N, 3) unit normals of the surfaces.
    """
    shade = np.ones(len(points))
    feet = _section(triangles, floor_m + _SECTION_M)
    rows = np.flatnonzero((np.abs(points[:, 2] - floor_m) < _NEAR_M) & (normals[:, 2] > _UP))
    rows = rows[_are_near(points[rows, :2], feet)] if len(feet) else rows
    if len(feet) and len(rows):
        gap, _ = cKDTree(feet).query(points[rows, :2], distance_upper_bound=_REACH_M)
        shade[rows] = 1 - _DEPTH * np.exp(-np.where(np.isfinite(gap), gap, 1e3) / _FADE_M)
    return shade


def _are_near(points: Floats, feet: Floats) -> Bools:
    """Returns whether each of the points (N, 2) may be within `_REACH_M` of one of the feet (K, 2).

    Tests whether a foot is in the same or an adjacent square of a grid with a pitch of `_REACH_M`.
    """
    low = np.minimum(points.min(axis=0, initial=np.inf), feet.min(axis=0)) - _REACH_M
    of_points, of_feet = (np.floor((places - low) / _REACH_M).astype(np.int64) for places in (points, feet))
    size = np.maximum(of_points.max(axis=0, initial=0), of_feet.max(axis=0)) + 2
    has_feet = np.zeros(size, bool)
    for right in (-1, 0, 1):
        for up in (-1, 0, 1):
            has_feet[of_feet[:, 0] + right, of_feet[:, 1] + up] = True
    return np.asarray(has_feet[of_points[:, 0], of_points[:, 1]])


def _section(triangles: Floats, height_m: float) -> Floats:
    """Returns points (K, 2) along the intersection of the triangles with a horizontal plane."""
    above = triangles[:, :, 2] > height_m
    cut = triangles[above.any(axis=1) & ~above.all(axis=1)]
    is_up = cut[:, :, 2] > height_m
    alone = np.where(is_up.sum(axis=1) == 1, is_up.argmax(axis=1), (~is_up).argmax(axis=1))
    rows = np.arange(len(cut))
    ends = []
    for shift in (1, 2):
        tip, other = cut[rows, alone], cut[rows, (alone + shift) % 3]
        share = (height_m - tip[:, 2]) / (other[:, 2] - tip[:, 2])
        ends.append(tip[:, :2] + share[:, None] * (other - tip)[:, :2])
    start, end = ends
    length = np.linalg.norm(end - start, axis=1)
    step = max(_STEP_M, float(length.sum()) / _MOST_SAMPLES)
    counts = np.ceil(length / step).astype(np.int64) + 1
    owner = np.repeat(rows, counts)
    within = (np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)) / np.maximum(counts[owner] - 1, 1)
    return np.asarray(start[owner] + within[:, None] * (end - start)[owner])


_COARSE_SKY, _COARSE_LAMPS = (8, 8), (4, 4)
FINE_SKY, FINE_LAMPS = (16, 64), (12, 24)
_EVEN_STEPS = (1, 2)
"""Distances over which noise is averaged, texels."""
_HIDDEN_GAIN, _DARK_GAIN = 0.0, 0.4
"""Relative texel density of charts inside solid objects, which get a single texel, and of charts that no lamp
reaches."""
_FLOOR_M, _LEVEL = 0.1, 0.9
"""A chart gets contact shade if it is within `_FLOOR_M` metres of the floor, and the vertical component of its normal
is above `_LEVEL`. The second condition does not apply to curved charts."""
_MIDDLE_GREY = 0.5
"""Reflectance of all surfaces if the caller does not give it."""


@dataclass(frozen=True)
class LightDetail:
    """Resolution of a light map, and number of rays of its texels."""

    density: float = 1.0
    """Texels per metre, relative to the usual number."""
    sky: Rays = FINE_SKY
    """Rays to the surroundings."""
    lamps: Rays = FINE_LAMPS
    """Rays to the lamps."""
    coarse: float = 0.25
    """Texels per metre of the coarse pass, relative to the usual number."""


USUAL_DETAIL = LightDetail()
LAYOUT_DETAIL = LightDetail(0.6, (16, 16), (8, 8), 0.18)
"""Detail of generated layouts: fewer texels and rays, with little visible difference."""


@dataclass(frozen=True)
class LightMap:
    """Baked light map of a scene."""

    uvs: NDArray[np.float32]
    """(T, 3, 2) light map coordinates of each corner, 0..1."""
    picture: NDArray[np.uint8]
    """(H, W, 3) gamma-encoded, 255 is full light."""


def bake_light(
    triangles: Floats,
    groups: Ints,
    brightness: Floats,
    floor_m: float,
    reflectance: Floats | None = None,
    detail: LightDetail = USUAL_DETAIL,
) -> LightMap:
    """Bakes the light map of a scene.

    Args:
        triangles: (T, 3, 3) visible triangles, world metres, counter-clockwise from outside.
        groups: (T,) part of each triangle; surfaces of different parts are not joined.
        brightness: (T,) emitted luminance; 0 for surfaces without emission.
        floor_m: height of the floor, metres.
        reflectance: (T,) luminance 0..1 of each surface in full light, for the exposure; middle grey when `None`.
        detail: resolution of the light map, and number of rays.
    """
    charts = find_charts(triangles, groups)
    bends = find_bends(charts, triangles, groups)
    glow = np.zeros(len(charts.area))
    np.maximum.at(glow, charts.of_triangle, brightness)
    bounds = np.array((triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))))
    caster, lamps = Caster(triangles), find_lamps(charts, glow, bounds, floor_m)
    gain = detail.density * _interest(caster, charts, bends=bends, lamps=lamps, coarse=detail.coarse)
    layout = unwrap(charts, gain, bends.least_texels())
    texels = lay_texels(charts, bends, layout)
    owner = np.full(layout.shape, -1, np.int64)
    owner[texels.cell] = texels.chart
    cast, known = _cast_light(caster, texels.cast(), lamps=lamps, owner=owner, detail=detail)
    touch = _contact(triangles, floor_m, texels)
    filled = fill_hidden(np.concatenate((cast, texel_maps(layout.shape, texels, touch))), known, owner)
    sky, free, whole, rim = filled
    emitting = texel_mask(layout.shape, texels, glow[texels.chart] > 0)
    grey = texel_maps(layout.shape, texels, _chart_means(charts, reflectance)[texels.chart])[0]
    picture = tone(sky * rim, whole * free, known & ~emitting, grey)
    picture[emitting] = 255
    return LightMap(layout.uvs.astype(np.float32), picture)


def _cast_light(caster: Caster, texels: Texels, lamps: Lamps, owner: Ints, detail: LightDetail) -> tuple[Floats, Bools]:
    """Returns maps (3, H, W): openness, lamp visibility, lamp light, smoothed within charts; and a validity mask."""
    sky, open_spots = sky_light(caster, texels, detail.sky)
    whole, free = lamp_light(caster, texels, open_spots=open_spots, lamps=lamps, rays=detail.lamps)
    known = texel_mask(owner.shape, texels, np.asarray(open_spots.any(axis=1)))
    bent = texel_mask(owner.shape, texels, texels.is_bent)
    cast = texel_maps(owner.shape, texels, sky, free, whole)
    smooth, is_near = smooth_charts(cast, known, owner)
    for step in _EVEN_STEPS:
        smooth[:2] = even_out(smooth[:2], is_near, owner, step)
    return np.where(bent, cast, smooth), np.where(bent, known, is_near)


def _interest(caster: Caster, charts: Charts, bends: Bends, lamps: Lamps, coarse: float) -> Floats:
    """Returns (C,) the relative texel density of each chart, from a coarse pass; hidden and dark charts have less than
    1."""
    layout = unwrap(charts, np.full(len(charts.area), coarse))
    grid = lay_texels(charts, bends, layout)
    texels, chart = grid.cast(), grid.chart[~grid.is_spare]
    _, open_spots = sky_light(caster, texels, _COARSE_SKY)
    whole, free = lamp_light(caster, texels, open_spots=open_spots, lamps=lamps, rays=_COARSE_LAMPS)
    shown = open_spots.any(axis=1)
    is_seen, is_lit = np.zeros(len(charts.area), bool), np.zeros(len(charts.area), bool)
    is_seen[chart[shown]] = True
    is_lit[chart[shown & (whole * free > 0)]] = True
    return np.where(is_lit, 1.0, np.where(is_seen, _DARK_GAIN, _HIDDEN_GAIN))


def _chart_means(charts: Charts, reflectance: Floats | None) -> Floats:
    """Returns (C,) the mean reflectance of each chart."""
    if reflectance is None:
        return np.full(len(charts.area), _MIDDLE_GREY)
    total = np.bincount(charts.of_triangle, reflectance)
    return np.asarray(total / np.bincount(charts.of_triangle))


def _contact(triangles: Floats, floor_m: float, texels: TexelGrid) -> Floats:
    """Returns (N,) the contact shade of all texels; charts that cannot be on the floor get 1 without computation."""
    charts = texels.charts
    height, shade = charts.anchors[..., 2] - floor_m, np.ones(len(texels.chart))
    is_near = (height.min(axis=1) < _FLOOR_M) & (height.max(axis=1) > -_FLOOR_M)
    rows = np.flatnonzero((is_near & (texels.bends.is_bent | (charts.axes[:, 2, 2] > _LEVEL)))[texels.chart])
    near = texels.place(rows)
    shade[rows] = contact_shade(triangles, floor_m, near.middles, near.axes[:, 2])
    return shade


def texel_maps(shape: tuple[int, int], texels: Texels | TexelGrid, *values: Floats) -> Floats:
    """Writes values (N,) of the texels into maps (K, H, W), zero elsewhere."""
    flat = np.zeros((len(values), *shape))
    for each, target in zip(values, flat, strict=True):
        target[texels.cell] = each
    return flat


def texel_mask(shape: tuple[int, int], texels: Texels | TexelGrid, chosen: Bools) -> Bools:
    """Writes values (N,) of the texels into a mask (H, W), false elsewhere."""
    mask = np.zeros(shape, bool)
    mask[texels.cell] = chosen
    return mask
