"""The texels of a light map as places in the world, each with its normal and its set of rays; pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factory.scenes.light.charts import Charts
from factory.scenes.light.curves import Bends
from factory.scenes.light.unwrap import Unwrap
from schemas.support.numpy_types import Bools, Floats, Ints

__all__ = ["PATTERN_SIDE", "Texels", "lay_texels"]

PATTERN_SIDE = 3
"""Flat texels deal out the patterns of rays over squares of three by three."""
_LIFT_M = 0.006
_LARGE = 8
"""Texels along the shorter side from which on a flat chart is large."""


@dataclass(frozen=True)
class Texels:
    """The texels that lie on surfaces, N of them."""

    cell: tuple[Ints, Ints]
    """Row and column in the map."""
    chart: Ints
    points: Floats
    """(N, 3) metres, just above the surface."""
    axes: Floats
    """(N, 3, 3) rows: along, across, normal; the normal is that of the round surface where pieces stand for one."""
    pattern: Ints
    """(N,) which set of rays; the first for all texels of bent charts, whose values are never averaged."""
    is_bent: Bools
    """(N,)"""
    is_spare: Bools
    """(N,) every other texel of large flat charts, as on a chess board: their neighbours can stand for them."""

    def cast(self) -> Texels:
        """Returns those that are worth casting rays from."""
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
    """Lays the texels of each chart over its rectangle, the outermost just inside its edges."""
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
    """Frames (N, 3, 3) with other normals, along as before as far as it can be."""
    along = axes[:, 0] - np.einsum("nk,nk->n", axes[:, 0], normals)[:, None] * normals
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    return np.stack((along, np.cross(normals, along), normals), axis=1)
