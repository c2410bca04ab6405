"""Maps the texels of a light map to world positions with normals and ray patterns. Pure. Casts no rays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factory.scenes.light.charts import Charts
from factory.scenes.light.curves import Bends
from factory.scenes.light.unwrap import Unwrap
from schemas.support.numpy_types import Bools, Floats, Ints

__all__ = ["PATTERN_SIDE", "Texels", "lay_texels"]

PATTERN_SIDE = 3
"""Side of the square of neighbouring texels over which ray patterns repeat, texels."""
_LIFT_M = 0.006
_LARGE = 8
"""Minimum length of the shorter side of a large flat chart, texels."""


@dataclass(frozen=True)
class Texels:
    """N texels on surfaces."""

    cell: tuple[Ints, Ints]
    """Rows and columns in the light map."""
    chart: Ints
    points: Floats
    """(N, 3) positions just above the surface, metres."""
    axes: Floats
    """(N, 3, 3) rows: along, across, normal; on curved charts, the smooth normal."""
    pattern: Ints
    """(N,) index of the ray pattern; 0 for texels of curved charts, whose values are not averaged."""
    is_bent: Bools
    """(N,) whether the texel is on a curved chart."""
    is_spare: Bools
    """(N,) whether the texel is interpolated from its neighbours: every second texel of large flat charts."""

    def cast(self) -> Texels:
        """Returns the texels that cast rays."""
        rows = np.flatnonzero(~self.is_spare)
        return Texels(
            cell=(self.cell[0][rows], self.cell[1][rows]),
            chart=self.chart[rows],
            points=self.points[rows],
            axes=self.axes[rows],
            pattern=self.pattern[rows],
            is_bent=self.is_bent[rows],
            is_spare=self.is_spare[rows],
        )


def lay_texels(charts: Charts, bends: Bends, layout: Unwrap) -> Texels:
    """Distributes the texels of each chart over its rectangle; the outermost are just inside its edges."""
    counts = layout.size.prod(axis=1)
    chart = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(len(chart)) - np.repeat(np.cumsum(counts) - counts, counts)
    wide = layout.size[chart, 0]
    local = np.column_stack((within % wide, within // wide))
    steps = np.maximum(layout.size[chart] - 1, 1)
    share = np.where(layout.size[chart] > 1, local / steps, 0.5)
    inside = np.where(layout.size[chart] > 1, np.clip(share, 0.15 / steps, 1 - 0.15 / steps), 0.5)
    metres = inside * charts.extent[chart]
    axes = charts.axes[chart]
    points = charts.origin[chart] + metres[:, :1] * axes[:, 0] + metres[:, 1:] * axes[:, 1] + _LIFT_M * axes[:, 2]
    place = layout.place[chart] + local
    is_bent = bends.is_bent[chart]
    bent = np.flatnonzero(is_bent)
    axes[bent] = _turned(axes[bent], bends.normals(chart[bent], share[bent]))
    pattern = np.where(is_bent, 0, local[:, 0] % PATTERN_SIDE + PATTERN_SIDE * (local[:, 1] % PATTERN_SIDE))
    is_spare = ((layout.size.min(axis=1) >= _LARGE)[chart]) & ~is_bent & (local.sum(axis=1) % 2 == 1)
    return Texels((place[:, 1], place[:, 0]), chart, points, axes, pattern, is_bent, is_spare)


def _turned(axes: Floats, normals: Floats) -> Floats:
    """Returns frames (N, 3, 3) rotated to new normals with a minimal change of the first axis."""
    along = axes[:, 0] - np.einsum("nk,nk->n", axes[:, 0], normals)[:, None] * normals
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    return np.stack((along, np.cross(normals, along), normals), axis=1)
