"""The lamps of a scene: whatever glows, as flat rectangles of light; lamps are hung where nothing does. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from factory.scenes.light.charts import Charts
from schemas.support.numpy_types import Floats, Singles

__all__ = ["Lamps", "find_lamps", "light_from", "nearest_lamps"]

_SMALLEST_M2 = 0.05
_MOST = 512
_HUNG_HEIGHT_M, _HUNG_SIDE_M, _HUNG_EVERY_M = 2.6, 0.6, 4.0
_NEAR_M2 = 0.15
"""Added to squared distances: a lamp right beside a wall must not burn it out."""


@dataclass(frozen=True)
class Lamps:
    """L rectangles that shine to one side."""

    corner: Floats
    """(L, 3) metres."""
    sides: Floats
    """(L, 2, 3) the two sides of the rectangle from its corner, metres."""
    normal: Floats
    """(L, 3) unit vectors into the light."""
    power: Floats
    """(L,) area times brightness."""

    @property
    def centre(self) -> Floats:
        """(L, 3) metres."""
        return np.asarray(self.corner + self.sides.sum(axis=1) / 2)

    def chosen(self, rows: NDArray[np.intp]) -> Lamps:
        """Returns some of the lamps."""
        return Lamps(self.corner[rows], self.sides[rows], self.normal[rows], self.power[rows])


def find_lamps(charts: Charts, brightness: Floats, bounds: Floats, floor_m: float) -> Lamps:
    """Returns the lamps of a scene.

    Args:
        charts: its flat pieces.
        brightness: (C,) of each piece, 0 for what does not glow.
        bounds: (2, 3) lower and upper corner of the scene, metres.
        floor_m: height of the floor; lamps are hung above it if no lamp shines.
    """
    glowing = np.flatnonzero((brightness > 0) & (charts.area >= _SMALLEST_M2))
    power = charts.area[glowing] * brightness[glowing]
    glowing = glowing[np.sort(np.argsort(-power, kind="stable")[:_MOST])]
    if not len(glowing):
        return _hung(bounds, floor_m)
    axes = charts.axes[glowing]
    return Lamps(
        corner=charts.origin[glowing],
        sides=axes[:, :2] * charts.extent[glowing][:, :, None],
        normal=axes[:, 2],
        power=charts.area[glowing] * brightness[glowing],
    )


def _hung(bounds: Floats, floor_m: float) -> Lamps:
    """A regular grid of square lamps over the whole scene, under its ceiling."""
    low, high = bounds
    height = min(floor_m + _HUNG_HEIGHT_M, max(float(high[2]) - 0.1, floor_m + 1.0))
    counts = np.clip(np.rint((high - low)[:2] / _HUNG_EVERY_M), 1, 16).astype(int)
    steps = [low[k] + (np.arange(counts[k]) + 0.5) * (high - low)[k] / counts[k] for k in (0, 1)]
    x, y = (values.ravel() for values in np.meshgrid(*steps))
    corner = np.column_stack((x, y, np.full(len(x), height))) - (_HUNG_SIDE_M / 2, _HUNG_SIDE_M / 2, 0.0)
    sides = np.tile(np.array([[[0.0, _HUNG_SIDE_M, 0.0], [_HUNG_SIDE_M, 0.0, 0.0]]]), (len(x), 1, 1))
    return Lamps(corner, sides, np.tile((0.0, 0.0, -1.0), (len(x), 1)), np.full(len(x), _HUNG_SIDE_M**2))


def nearest_lamps(lamps: Lamps, place: Floats, most: int) -> Lamps:
    """Returns the lamps that can matter most around a place (3,), in a stable order."""
    gap = lamps.centre - place
    weight = lamps.power / (np.einsum("lk,lk->l", gap, gap) + 1.0)
    return lamps.chosen(np.sort(np.argsort(-weight, kind="stable")[:most]))


def light_from(lamps: Lamps, points: Singles, normals: Singles) -> Singles:
    """Returns (L, N) the light that each lamp would throw on N points facing along `normals`, with nothing between.

    Args:
        lamps: L of them.
        points: (3, N) metres.
        normals: (3, N) unit vectors.
    """
    centre, facing = (np.asarray(values.T[:, :, None], np.float32) for values in (lamps.centre, lamps.normal))
    x, y, z = centre[0] - points[0], centre[1] - points[1], centre[2] - points[2]
    squared = x * x + y * y + z * z + np.float32(_NEAR_M2)
    arriving = np.maximum(x * normals[0] + y * normals[1] + z * normals[2], 0)
    leaving = np.maximum(-(x * facing[0] + y * facing[1] + z * facing[2]), 0)
    power = np.asarray(lamps.power[:, None], np.float32)
    return np.asarray(power * arriving * leaving / (squared * squared), np.float32)
