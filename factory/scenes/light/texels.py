"""Maps the texels of a light map to world positions with normals and ray patterns. Pure functions. Casts no rays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from factory.scenes.light.charts import Charts, Unwrap, interpolate
from factory.scenes.light.curves import Bends
from schemas.support.numpy_types import Bools, Floats, Ints

PATTERNS = 64
"""Number of ray patterns."""
SPOTS = 4
"""Number of positions of a texel at which rays start."""
# with one position, an object above that point darkened the whole texel, and smoothing spread the darkness to visible
# neighbours
_OFFSETS = np.array(((-0.25, -0.25), (0.25, 0.25), (0.25, -0.25), (-0.25, 0.25)))
"""(SPOTS, 2) positions relative to the centre of a texel of a flat chart, texels."""
_LIFT_M = 0.006
_INSET, _BENT_INSET = 0.1, 0.03
"""Least distance of a ray's start from the edge of a flat chart, and from the edge of a curved chart, texels."""
_LARGE = 8
"""A flat chart is large if its shorter side has at least this length, texels."""
# only every other texel of a large chart casts rays, because the light is averaged over 3 x 3 texels anyway
_DITHER = np.array((0.7548776662466927, 0.5698402909980532))
"""Steps of the R2 sequence (plastic number), which spread the patterns evenly over neighbouring texels."""


@dataclass(frozen=True)
class Texels:
    """N texels with their places on surfaces."""

    cell: tuple[Ints, Ints]
    """Rows and columns in the light map."""
    points: Floats
    """(N, SPOTS, 3) positions just above the surface, metres; on curved charts, all positions of a texel are equal."""
    axes: Floats
    """(N, 3, 3) rows: along, across, normal; on curved charts, the smooth normal."""
    pattern: Ints
    """(N,) index of the ray pattern; 0 for texels of curved charts, whose values are not averaged."""
    is_bent: Bools
    """(N,) whether the texel is on a curved chart."""

    @cached_property
    def middles(self) -> Floats:
        """(N, 3) mean positions, metres."""
        return np.asarray(self.points.mean(axis=1))


@dataclass(frozen=True)
class TexelGrid:
    """All texels of a light map, without their places on surfaces, which `place` computes for some of them."""

    charts: Charts
    bends: Bends
    layout: Unwrap
    cell: tuple[Ints, Ints]
    """Rows and columns in the light map."""
    chart: Ints
    """(N,) chart of each texel."""
    local: Ints
    """(N, 2) column and row in the rectangle of the chart."""
    is_spare: Bools
    """(N,) whether the texel is interpolated from its neighbours: every second texel of large flat charts."""

    def cast(self) -> Texels:
        """Returns the texels that cast rays."""
        return self.place(np.flatnonzero(~self.is_spare))

    def place(self, rows: NDArray[np.intp]) -> Texels:
        """Returns some texels with their places."""
        chart, local, size = self.chart[rows], self.local[rows], self.layout.size[self.chart[rows]]
        is_bent, axes = self.bends.is_bent[chart], self.charts.axes[chart]
        bent = np.flatnonzero(is_bent)
        share = np.where(size[bent] > 1, local[bent] / np.maximum(size[bent] - 1, 1), 0.5)
        axes[bent] = _frames(self.bends.normals(chart[bent], share))
        pattern = (PATTERNS * ((local * _DITHER).sum(axis=1) % 1.0)).astype(np.int64)
        return Texels(
            cell=(self.cell[0][rows], self.cell[1][rows]),
            points=_points(self.charts, chart, local, size, is_bent) + _LIFT_M * axes[:, None, 2],
            axes=axes,
            pattern=np.where(is_bent, 0, pattern),
            is_bent=is_bent,
        )


def lay_texels(charts: Charts, bends: Bends, layout: Unwrap) -> TexelGrid:
    """Distributes the texels of each chart over its square; the outermost are just inside its edges."""
    counts = layout.size.prod(axis=1)
    chart = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(len(chart)) - np.repeat(np.cumsum(counts) - counts, counts)
    down, right = np.divmod(within, layout.size[chart, 0])
    local = np.column_stack((right, down))
    place = layout.place[chart] + local
    is_dense = (layout.size.min(axis=1) >= _LARGE) & ~bends.is_bent
    is_spare = is_dense[chart] & ((right + down) % 2 == 1)
    return TexelGrid(
        charts, bends, layout=layout, cell=(place[:, 1], place[:, 0]), chart=chart, local=local, is_spare=is_spare
    )


def _points(charts: Charts, chart: Ints, local: Ints, size: Ints, is_bent: Bools) -> Floats:
    """Returns (N, SPOTS, 3) positions on the surface, metres."""
    points = np.empty((len(chart), SPOTS, 3))
    for rows, offsets, least in (
        (np.flatnonzero(~is_bent), _OFFSETS, _INSET),
        (np.flatnonzero(is_bent), np.zeros((1, 2)), _BENT_INSET),
    ):
        steps = np.maximum(size[rows] - 1, 1)[:, None]
        share = np.where(size[rows][:, None] > 1, (local[rows][:, None] + offsets) / steps, 0.5)
        inset = least / steps
        points[rows] = interpolate(charts.anchors, chart[rows], np.clip(share, inset, 1 - inset))
    return points


def _frames(normals: Floats) -> Floats:
    """Returns frames (N, 3, 3) that are a function of the unit normals, continuous except at (0, 0, -1).

    Source: Duff et al., Building an Orthonormal Basis, Revisited, JCGT 6(1), 2017.
    """
    x, y, z = normals.T
    sign = np.where(z < 0, -1.0, 1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    along = np.stack((1.0 + sign * x * x * a, sign * b, -sign * x), axis=1)
    across = np.stack((b, sign + y * y * a, -y), axis=1)
    return np.stack((along, across, normals), axis=1)
