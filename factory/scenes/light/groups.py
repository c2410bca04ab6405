"""Bakes the light groups of a compiled scene: casts rays to each lamp group from the texels of its light map.

Needs the package only. Does not change the light map; the result is the share of each group in its light. Results are
kept in the cache; one process bakes them, and others wait.

Design: docs/design/rendering.md#varied-light-is-mixed-from-shares.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import structlog
from numpy.typing import NDArray

from factory.scenes.cached import write_whole
from factory.scenes.light.bake import FINE_LAMPS, FINE_SKY, texel_maps, texel_mask
from factory.scenes.light.charts import Charts, Unwrap, find_charts
from factory.scenes.light.curves import find_bends
from factory.scenes.light.irradiance import Lamps, find_lamps, lamp_light, sky_light
from factory.scenes.light.smooth import CONTACT, FLOOR, SHELTER, SKY_SHARE, fill_hidden, smooth_charts
from factory.scenes.light.texels import lay_texels
from schemas.appearance.light_groups import (
    LIGHT_FORMAT,
    SCREENS,
    LampGroup,
    LightGroups,
    LightGroupsInfo,
    encode_light_groups,
)
from schemas.scene import CompiledScene, read_scene
from schemas.storage.disk import translated
from schemas.support.extras import require_package
from schemas.support.numpy_types import Bools, Floats, Ints
from workers.client.host_lock import exclusive_lock
from workers.geometry.rays import Caster

_POLL_S = 0.2


def bake_once(package: Path, sha256: str, folder: Path) -> Path:
    """Returns the file of the light groups of a package, which is baked if the folder does not have it.

    Args:
        package: compiled scene.
        sha256: digest of the package.
        folder: folder of light groups; created if missing.

    Raises:
        InvalidBundle: the package is damaged.
        UsageError: embreex is not installed.
        WorldError: the folder cannot be written.
    """
    path = folder / f"{sha256}-{LIGHT_FORMAT}.light.zip"
    if path.is_file():
        return path
    require_package("embreex", "randomised light")

    with translated("write", folder):
        folder.mkdir(parents=True, exist_ok=True)
        with exclusive_lock(folder / f"{sha256}.lock", lambda: time.sleep(_POLL_S)):
            if not path.is_file():
                scene = read_scene(package)
                structlog.get_logger(__name__).info("light_groups_baked", scene=scene.info.name, path=str(path))
                write_whole(path, encode_light_groups(bake_light_groups(scene, sha256)))
    return path


_CEILING_GROUPS = 6
"""Largest number of groups of lamps that shine down."""
_SCREEN_M2 = 0.6
"""A lamp that does not shine down is a screen if its area is below this, square metres; otherwise, it is a window."""
_DOWN = -0.7
_FULL = 255
_INDIRECT = 0.7
"""Share of the ambient light that lamps emit and other surfaces reflect; the rest comes from the sky."""
_CHUNK = 1 << 14
_OFF_SHARE = 0.03
"""Share of the light of a lamp's surface that counts as light of the sky, so a lamp that is off is not black."""


def bake_light_groups(scene: CompiledScene, sha256: str) -> LightGroups:
    """Returns the light groups of a scene; a scene without a light map has none.

    Args:
        scene: compiled scene.
        sha256: digest of its package.
    """
    if not scene.light_map.size:
        return LightGroups(LightGroupsInfo(scene_sha256=sha256, groups=()), np.zeros((1, 0, 0), np.uint8))
    triangles = scene.positions.reshape(-1, 3, 3).astype(np.float64)
    parts = np.repeat(np.arange(len(scene.part_count)), scene.part_count // 3)
    charts = find_charts(triangles, parts)
    bends, layout = find_bends(charts, triangles, parts), _layout_of(scene, charts)
    texels = lay_texels(charts, bends, layout)
    glow = _glow(scene, charts, texels.cell, texels.chart)
    bounds = np.array((triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))))
    lamps = find_lamps(charts, glow, bounds, scene.info.floor_height_m)
    members = group_lamps(lamps)
    owner = np.full(layout.shape, -1, np.int64)
    owner[texels.cell] = texels.chart
    cast, caster = texels.cast(), Caster(triangles)
    sky, open_spots = sky_light(caster, cast, FINE_SKY)
    reached = [
        np.multiply(*lamp_light(caster, cast, open_spots=open_spots, lamps=lamps.chosen(rows), rays=FINE_LAMPS))
        for rows in members
    ]
    known = texel_mask(layout.shape, cast, np.asarray(open_spots.any(axis=1)))
    smooth, is_near = smooth_charts(texel_maps(layout.shape, cast, sky, *reached), known, owner)
    filled = fill_hidden(smooth, is_near, owner)
    info = LightGroupsInfo(scene_sha256=sha256, groups=tuple(_describe(lamps, rows) for rows in members))
    is_strong = [group.kind != SCREENS for group in info.groups]
    bounced = texel_maps(
        layout.shape, texels, *_indirect(lamps, members, is_strong, texels.place(np.arange(len(texels.chart))).middles)
    )
    shares = _shares(filled[0], filled[1:], bounced, is_near)
    _light_lamps(shares, members, lamps=lamps, charts=charts, owner=owner, glow=glow)
    return LightGroups(info, _quantised(shares))


def group_lamps(lamps: Lamps) -> list[Ints]:
    """Returns the lamps of each group: first lamps that shine down, grouped by position, then windows, then screens."""
    area = np.linalg.norm(np.cross(lamps.sides[:, 0], lamps.sides[:, 1]), axis=1)
    is_down = lamps.normal[:, 2] < _DOWN
    groups = [np.flatnonzero(is_down)]
    while len(groups) < _CEILING_GROUPS:
        widest = max(groups, key=lambda rows: np.ptp(lamps.centre[rows, :2], axis=0).max() if len(rows) > 1 else -1.0)
        if len(widest) < 2:
            break
        at = next(number for number, rows in enumerate(groups) if rows is widest)
        groups[at : at + 1] = _halves(lamps, widest)
    others = [np.flatnonzero(~is_down & (area >= _SCREEN_M2)), np.flatnonzero(~is_down & (area < _SCREEN_M2))]
    return [rows for rows in (*groups, *others) if len(rows)]


def _halves(lamps: Lamps, rows: Ints) -> list[Ints]:
    """Divides lamps into two groups of equal number along the longer side of their extent."""
    places = lamps.centre[rows, :2]
    along = places[:, int(np.argmax(np.ptp(places, axis=0)))]
    order = np.argsort(along, kind="stable")
    half = len(rows) // 2
    return [np.sort(rows[order[:half]]), np.sort(rows[order[half:]])]


def _describe(lamps: Lamps, rows: Ints) -> LampGroup:
    area = np.linalg.norm(np.cross(lamps.sides[rows, 0], lamps.sides[rows, 1]), axis=1)
    is_down = lamps.normal[rows[0], 2] < _DOWN
    kind = "lamps" if is_down else "windows" if area[0] >= _SCREEN_M2 else SCREENS
    x, y, z = (round(float(value), 3) for value in lamps.centre[rows].mean(axis=0))
    return LampGroup(kind=kind, lamps=len(rows), centre_m=(x, y, z))


def _layout_of(scene: CompiledScene, charts: Charts) -> Unwrap:
    """Returns the layout of the charts in the light map, computed from the light map coordinates in the package."""
    rows, columns = scene.light_map.shape[:2]
    texel = scene.light_uvs.astype(np.float64) * (columns, rows) - 0.5
    chart, share = np.repeat(charts.of_triangle, 3), charts.share.reshape(-1, 2)
    low, steps = np.empty((2, len(charts.area), 2))
    for side in (0, 1):
        (first, last), (begin, end) = (_extremes(values[:, side], chart, len(low)) for values in (share, texel))
        steps[:, side] = (end - begin) / np.maximum(last - first, 1e-9)
        low[:, side] = begin - first * steps[:, side]
    place = np.clip(np.rint(low), 0, (columns - 1, rows - 1)).astype(np.int64)
    size = np.clip(np.rint(steps) + 1, 1, (columns, rows) - place).astype(np.int64)
    return Unwrap((rows, columns), place, size, scene.light_uvs.reshape(-1, 3, 2).astype(np.float64))


def _extremes(values: Floats, chart: Ints, count: int) -> tuple[Floats, Floats]:
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(low, chart, values)
    np.maximum.at(high, chart, values)
    return low, high


def _glow(scene: CompiledScene, charts: Charts, cell: tuple[Ints, Ints], chart: Ints) -> Floats:
    """Returns (C,) the emitted luminance of charts. A chart emits light if all its texels have full light."""
    is_full = (scene.light_map[cell] == _FULL).all(axis=1)
    emits = np.ones(len(charts.area), bool)
    emits[chart[~is_full]] = False
    layer = np.repeat(scene.part_texture, scene.part_count // 3)
    grey = scene.colours.reshape(-1, 3, 3).mean(axis=(1, 2)) / _FULL
    if scene.textures:
        tones = np.stack([pixels[::8, ::8] for pixels in scene.textures]).mean(axis=(1, 2, 3)) / _FULL
        grey = grey * np.where(layer >= 0, tones[np.maximum(layer, 0)], 1.0)
    glow = np.zeros(len(charts.area))
    np.maximum.at(glow, charts.of_triangle, np.clip(grey**2.2, 0.01, 1.0))
    return np.where(emits, glow, 0.0)


def _indirect(lamps: Lamps, members: list[Ints], is_strong: list[bool], points: Floats) -> Floats:
    """Returns (K, N) the share of each group in the indirect light at N points, estimated from power and distance."""
    light = np.zeros((len(members), len(points)))
    for first in range(0, len(points), _CHUNK):
        run = slice(first, first + _CHUNK)
        for number in np.flatnonzero(is_strong):
            rows = members[number]
            gaps = points[run, None] - lamps.centre[rows]
            near = lamps.power[rows] / (np.einsum("nlk,nlk->nl", gaps, gaps) + 1.0) ** 1.5
            light[number, run] = near.sum(axis=1)
    return np.asarray(light / np.maximum(light.sum(axis=0), 1e-30))


def _shares(sky: Floats, lamps: Floats, bounced: Floats, known: Bools) -> Floats:
    """Returns (K + 1, H, W) shares of the sky and of K lamp groups in the light before the tone curve."""
    total = lamps.sum(axis=0)
    lit = known & (total > 0)
    mean = float(total[lit].mean()) if lit.any() else 1.0
    ambient = FLOOR + SKY_SHARE * sky**CONTACT
    direct = (1 - SKY_SHARE) / mean * lamps * sky**SHELTER
    parts = np.concatenate(
        ((ambient * (1 - _INDIRECT * bounced.sum(axis=0)))[None], direct + _INDIRECT * ambient * bounced)
    )
    return np.asarray(parts / parts.sum(axis=0))


def _light_lamps(shares: Floats, members: list[Ints], lamps: Lamps, charts: Charts, owner: Ints, glow: Floats) -> None:
    """Assigns the light of emitting surfaces to the group of the nearest lamp; other surfaces keep their shares."""
    group = np.concatenate([np.full(len(rows), number) for number, rows in enumerate(members, 1)])
    rows = np.concatenate(members)
    emitting = np.flatnonzero(glow > 0)
    if not len(emitting):
        return
    corners = charts.anchors[emitting].mean(axis=1)
    gaps = np.linalg.norm(corners[:, None] - lamps.centre[rows][None], axis=2)
    of_chart = np.zeros(len(glow), np.int64)
    of_chart[emitting] = group[gaps.argmin(axis=1)]
    texel = np.where(owner >= 0, of_chart[owner], 0)
    for number in range(1, len(shares)):
        is_own = texel == number
        shares[:, is_own] = 0.0
        shares[0, is_own], shares[number, is_own] = _OFF_SHARE, 1 - _OFF_SHARE


def _quantised(shares: Floats) -> NDArray[np.uint8]:
    """Returns shares that add up to 255 exactly."""
    ends = np.rint(np.cumsum(shares, axis=0) * _FULL)
    ends[-1] = _FULL
    return np.diff(ends, axis=0, prepend=0).astype(np.uint8)
