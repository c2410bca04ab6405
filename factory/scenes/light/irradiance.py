"""Computes the light of each texel: ambient light with occlusion, and lamp light with shadows. Deterministic.

A spot is a position of a texel at which rays start. Texels of flat charts cast few rays from several spots;
neighbouring texels have different ray patterns, and their light is averaged later. Texels of curved charts cast more
rays in one pattern, so the light is smooth over small charts. A spot does not count if it is inside a solid or
covered by an object that rests on the surface. Lamps are emissive charts, or a default grid if no chart emits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from factory.scenes.light.charts import Charts, number_rows
from factory.scenes.light.texels import PATTERNS, SPOTS, Texels
from schemas.support import portable
from schemas.support.numpy_types import Bools, Floats, Ints, Singles
from workers.geometry.rays import Caster

_SMALLEST_M2 = 0.05
_MOST = 512
_HUNG_HEIGHT_M, _HUNG_SIDE_M, _HUNG_EVERY_M = 2.6, 0.6, 4.0
"""Height above the floor, side and spacing of the lamps that a scene gets if it has no emissive surface of at least
`_SMALLEST_M2`, metres: panels below the ceiling of a room of usual height."""
_NEAR_M2 = 0.15
"""Added to squared distances from lamps, square metres, so walls next to a lamp are not overexposed."""


@dataclass(frozen=True)
class Lamps:
    """L one-sided rectangular area lights."""

    corner: Floats
    """(L, 3) first corner of the rectangle, metres."""
    sides: Floats
    """(L, 2, 3) side vectors from the corner, metres."""
    normal: Floats
    """(L, 3) unit vectors in the direction of emission."""
    power: Floats
    """(L,) area times luminance."""

    @property
    def centre(self) -> Floats:
        """Centre of each rectangle (L, 3), metres."""
        return np.asarray(self.corner + self.sides.sum(axis=1) / 2)

    def chosen(self, rows: NDArray[np.intp]) -> Lamps:
        return Lamps(self.corner[rows], self.sides[rows], self.normal[rows], self.power[rows])


def find_lamps(charts: Charts, brightness: Floats, bounds: Floats, floor_m: float) -> Lamps:
    """Returns the lamps of a scene.

    Args:
        charts: flat charts of the scene.
        brightness: (C,) emitted luminance; 0 without emission.
        bounds: (2, 3) lower and upper corner of the scene, metres.
        floor_m: height of the floor, metres; default lamps are placed above it if no chart emits.
    """
    glowing = np.flatnonzero((brightness > 0) & (charts.area >= _SMALLEST_M2))
    power = charts.area[glowing] * brightness[glowing]
    glowing = glowing[np.sort(np.argsort(-power, kind="stable")[:_MOST])]
    if not len(glowing):
        return _hung(bounds, floor_m)
    corner = charts.anchors[glowing, 0]
    return Lamps(
        corner=corner,
        sides=charts.anchors[glowing][:, [1, 3]] - corner[:, None],
        normal=charts.axes[glowing, 2],
        power=charts.area[glowing] * brightness[glowing],
    )


def _hung(bounds: Floats, floor_m: float) -> Lamps:
    """Returns a regular grid of square lamps below the ceiling of the scene."""
    low, high = bounds
    height = min(floor_m + _HUNG_HEIGHT_M, max(float(high[2]) - 0.1, floor_m + 1.0))
    counts = np.clip(np.rint((high - low)[:2] / _HUNG_EVERY_M), 1, 16).astype(int)
    steps = [low[k] + (np.arange(counts[k]) + 0.5) * (high - low)[k] / counts[k] for k in (0, 1)]
    x, y = (values.ravel() for values in np.meshgrid(*steps))
    corner = np.column_stack((x, y, np.full(len(x), height))) - (_HUNG_SIDE_M / 2, _HUNG_SIDE_M / 2, 0.0)
    sides = np.tile(np.array([[[0.0, _HUNG_SIDE_M, 0.0], [_HUNG_SIDE_M, 0.0, 0.0]]]), (len(x), 1, 1))
    return Lamps(corner, sides, np.tile((0.0, 0.0, -1.0), (len(x), 1)), np.full(len(x), _HUNG_SIDE_M**2))


def nearest_lamps(lamps: Lamps, place: Floats, most: int) -> NDArray[np.intp]:
    """Returns the numbers of the `most` lamps with the strongest effect at a position (3,), in ascending order."""
    gap = lamps.centre - place
    weight = lamps.power / (np.einsum("lk,lk->l", gap, gap) + 1.0)
    return np.sort(np.argsort(-weight, kind="stable")[:most])


def light_from(lamps: Lamps, near: Ints, points: Singles, normals: Singles) -> Singles:
    """Returns (L, N) the unoccluded light of some lamps at N points with given normals.

    Args:
        lamps: all lamps.
        near: (L, N) numbers of the lamps of each point.
        points: (3, N) positions, metres.
        normals: (3, N) unit vectors.
    """
    centre, facing = (np.asarray(values.T, np.float32) for values in (lamps.centre, lamps.normal))
    x, y, z = (centre[k].take(near) - points[k] for k in range(3))
    squared = x * x + y * y + z * z + np.float32(_NEAR_M2)
    arriving = np.maximum(x * normals[0] + y * normals[1] + z * normals[2], 0)
    leaving = np.maximum(-(x * facing[0].take(near) + y * facing[1].take(near) + z * facing[2].take(near)), 0)
    power = np.asarray(lamps.power, np.float32).take(near)
    return np.asarray(power * arriving * leaving / (squared * squared), np.float32)


_REACH_M = 1.6
"""Length of the rays to the surroundings, metres."""
# in a closed room every ray meets a surface, so a longer reach darkens whole rooms, and a shorter one shades only the
# immediate surroundings of objects. No measurement of it is recorded
_CELL_M = 2.5
_LAMPS_A_CELL = 24
_HIDDEN_SHARE = 0.35
"""A spot is inside a solid if more than this share of its rays meet a back face."""
_COVER_M, _COVERED_SHARE = 0.03, 0.7
"""A spot is covered if more than `_COVERED_SHARE` of its rays meet a surface within `_COVER_M`, metres."""
_CHUNK = 1 << 13
"""Number of texels per batch; the working set of a batch fits the processor cache."""
_LAMP_CHUNK = 1 << 12
"""Number of texels per batch for the light of lamps; smaller, because a texel needs values for each lamp near it."""

Rays = tuple[int, int]
"""Number of rays of a texel on a flat chart, and number of rays of a texel on a curved chart; multiples of `SPOTS`."""


def _sequence(count: int) -> Floats:
    """Returns low-discrepancy points (PATTERNS, count, 2), 0..1: an R2 (plastic number) sequence, shifted by the points
    of a Hammersley set, so the patterns together are evenly distributed too.
    """
    steps = np.arange(1, count + 1)[:, None] * (0.7548776662466927, 0.5698402909980532)
    numbers = np.arange(PATTERNS)
    digits = numbers[:, None] >> np.arange(PATTERNS.bit_length() - 1) & 1
    mirrored = (digits / 2.0 ** np.arange(1, PATTERNS.bit_length())).sum(axis=1)
    shifts = np.column_stack(((numbers + 0.5) / PATTERNS, mirrored))
    return np.asarray((steps[None] + shifts[:, None]) % 1.0)


def sky_light(caster: Caster, texels: Texels, rays: Rays) -> tuple[Floats, Bools]:
    """Returns (N,) the openness of the half-space above each texel, 0..1, and (N, SPOTS) the spots that count."""
    opening, open_spots = np.zeros(len(texels.pattern)), np.zeros((len(texels.pattern), SPOTS), bool)
    for is_bent, count in zip((False, True), rays, strict=True):
        rows = np.flatnonzero(texels.is_bent == is_bent)
        for first in range(0, len(rows), _CHUNK):
            run = rows[first : first + _CHUNK]
            opening[run], open_spots[run] = _sky(caster, texels, run, count)
    return opening, open_spots


def _sky(caster: Caster, texels: Texels, run: Ints, count: int) -> tuple[Singles, Bools]:
    numbers = _sequence(count)
    radius, turn = np.sqrt(numbers[..., 0]), 2 * np.pi * numbers[..., 1]
    local = (radius * portable.cos(turn), radius * portable.sin(turn), np.sqrt(1 - numbers[..., 0]))
    patterns = [np.asarray(part, np.float32) for part in local]
    axes = np.ascontiguousarray(texels.axes[run].transpose(1, 2, 0), np.float32)
    points = np.ascontiguousarray(texels.points[run].swapaxes(0, 1), np.float32)
    pattern, way = texels.pattern[run], np.empty(points.shape[1:], np.float32)
    reached = np.zeros((SPOTS, len(run)), np.float32)
    backs, covers = np.zeros((2, SPOTS, len(run)), np.float32)
    for ray in range(count):
        along, across, up = (part[:, ray].take(pattern) for part in patterns)
        for k in range(3):
            way[:, k] = along * axes[0, k] + across * axes[1, k] + up * axes[2, k]
        spot = ray % SPOTS
        distance, met_back = caster.first_hits(points[spot], way, _REACH_M)
        reached[spot] += distance
        backs[spot] += met_back
        covers[spot] += distance < _COVER_M
    if texels.is_bent[run[0]]:
        backs[:], covers[:] = backs.mean(axis=0), covers.mean(axis=0)
    each = count / SPOTS
    counts = (backs <= _HIDDEN_SHARE * each) & (covers <= _COVERED_SHARE * each)
    total = np.maximum(counts.sum(axis=0), 1) * np.float32(_REACH_M * each)
    return (reached * counts).sum(axis=0) / total, counts.T


def lamp_light(caster: Caster, texels: Texels, open_spots: Bools, lamps: Lamps, rays: Rays) -> tuple[Floats, Floats]:
    """Returns (N,) the unoccluded light of the lamps at each texel, and (N,) the share of this light that reaches the
    texel, measured at the spots that count."""
    middle = texels.middles
    cell = number_rows(np.column_stack((np.floor(middle / _CELL_M), texels.is_bent)).astype(np.int64))
    order = np.argsort(cell, kind="stable")
    ends = np.flatnonzero(np.diff(cell[order])) + 1
    near = np.stack([nearest_lamps(lamps, middle[rows].mean(axis=0), _LAMPS_A_CELL) for rows in np.split(order, ends)])
    whole, free = np.zeros(len(order)), np.ones(len(order))
    for is_bent, count in zip((False, True), rays, strict=True):
        rows = order[texels.is_bent[order] == is_bent]
        for first in range(0, len(rows), _LAMP_CHUNK):
            run = rows[first : first + _LAMP_CHUNK]
            whole[run], free[run] = _lit(caster, texels, run, open_spots[run], lamps, near[cell[run]].T, count)
    return whole, free


def _lit(
    caster: Caster, texels: Texels, run: Ints, open_spots: Bools, lamps: Lamps, near: Ints, count: int
) -> tuple[Singles, Singles]:
    """Casts rays to points on lamps of `near` (L, N), to each lamp in proportion to its unoccluded light at the texel.

    Returns (N,) the unoccluded light, and (N,) the share of it that is not occluded.
    """
    spots, normals = texels.points[run], np.ascontiguousarray(texels.axes[run, 2].T, np.float32)
    points = np.ascontiguousarray(texels.middles[run].T, np.float32)
    reached = light_from(lamps, near, points, normals).cumsum(axis=0)
    whole, free = reached[-1], np.zeros(len(run), np.float32)
    rows = np.flatnonzero((whole > 1e-6) & open_spots.any(axis=1))
    if not len(rows):
        return whole, free
    pattern, reached, is_open = texels.pattern[run[rows]], reached[:, rows], open_spots[rows]
    near, each = near[:, rows], np.arange(len(rows))
    origins = np.ascontiguousarray(spots[rows].swapaxes(0, 1), np.float32)
    numbers = np.asarray(_sequence(count), np.float32)
    shift = np.asarray((pattern + 0.5) / PATTERNS, np.float32)
    corner = np.asarray((lamps.corner + 0.01 * lamps.normal).T, np.float32)
    sides = np.asarray(lamps.sides.transpose(1, 2, 0), np.float32)
    way, met = np.empty((len(rows), 3), np.float32), np.zeros(len(rows))
    for ray in range(count):
        wanted = reached[-1] * ((ray + shift) / np.float32(count))
        place = np.minimum((reached < wanted).sum(axis=0, dtype=np.int16), len(near) - 1)
        lamp = near[place, each]
        along, across = (numbers[:, ray, side].take(pattern) for side in (0, 1))
        spot = ray % SPOTS
        gap = [
            corner[k].take(lamp)
            + along * sides[0, k].take(lamp)
            + across * sides[1, k].take(lamp)
            - origins[spot, :, k]
            for k in range(3)
        ]
        length = np.maximum(np.sqrt(gap[0] * gap[0] + gap[1] * gap[1] + gap[2] * gap[2]), np.float32(1e-6))
        for k in range(3):
            way[:, k] = gap[k] / length
        met += caster.is_free(origins[spot], way, length) & is_open[:, spot]
    free[rows] = met * (SPOTS / count) / is_open.sum(axis=1)
    return whole, free
