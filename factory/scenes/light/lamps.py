"""Finds the area lights of a scene: emissive charts, or a default grid of ceiling lamps if no chart emits.

Pure functions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from factory.scenes.light.charts import Charts
from schemas.support.numpy_types import Floats, Ints, Singles

_SMALLEST_M2 = 0.05
_MOST = 512
_HUNG_HEIGHT_M, _HUNG_SIDE_M, _HUNG_EVERY_M = 2.6, 0.6, 4.0
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
        """Returns a selection of the lamps."""
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
