"""Maps the texels of a light map to world positions with normals and ray patterns. Pure functions. Casts no rays."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from factory.scenes.light.charts import Charts
from factory.scenes.light.curves import Bends
from factory.scenes.light.patches import interpolate
from factory.scenes.light.unwrap import Unwrap
from schemas.support.numpy_types import Bools, Floats, Ints

PATTERNS = 64
"""Number of ray patterns."""
SPOTS = 4
"""Number of positions of a texel at which rays start."""
_OFFSETS = np.array(((-0.25, -0.25), (0.25, 0.25), (0.25, -0.25), (-0.25, 0.25)))
"""(SPOTS, 2) positions relative to the centre of a texel of a flat chart, texels."""
_LIFT_M = 0.006
_INSET, _BENT_INSET = 0.1, 0.03
"""Least distance of a ray's start from the edge of a flat and of a curved chart, texels."""
_LARGE = 8
"""Minimum length of the shorter side of a large flat chart, texels."""
_DITHER = np.array((0.7548776662466927, 0.5698402909980532))
"""Steps of the R2 sequence (plastic number), which spread the patterns evenly over neighbouring texels."""


@dataclass(frozen=True)
class Texels:
    """N texels on surfaces."""

    cell: tuple[Ints, Ints]
    """Rows and columns in the light map."""
    chart: Ints
    points: Floats
    """(N, SPOTS, 3) positions just above the surface, metres; equal on curved charts."""
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
        others = {field.name: getattr(self, field.name)[rows] for field in fields(self) if field.name != "cell"}
        return Texels(cell=(self.cell[0][rows], self.cell[1][rows]), **others)


def lay_texels(charts: Charts, bends: Bends, layout: Unwrap) -> Texels:
    """Distributes the texels of each chart over its square; the outermost are just inside its edges."""
    counts = layout.size.prod(axis=1)
    chart = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(len(chart)) - np.repeat(np.cumsum(counts) - counts, counts)
    wide = layout.size[chart, 0]
    local = np.column_stack((within % wide, within // wide))
    place, is_bent = layout.place[chart] + local, bends.is_bent[chart]
    axes, bent = charts.axes[chart], np.flatnonzero(is_bent)
    steps = np.maximum(layout.size[chart] - 1, 1)
    share = np.where(layout.size[chart] > 1, local / steps, 0.5)
    axes[bent] = _frames(bends.normals(chart[bent], share[bent]))
    pattern = (PATTERNS * ((local * _DITHER).sum(axis=1) % 1.0)).astype(np.int64)
    is_large = (layout.size.min(axis=1) >= _LARGE)[chart]
    return Texels(
        cell=(place[:, 1], place[:, 0]),
        chart=chart,
        points=_points(charts, chart, local, layout.size[chart], is_bent) + _LIFT_M * axes[:, None, 2],
        axes=axes,
        pattern=np.where(is_bent, 0, pattern),
        is_bent=is_bent,
        is_spare=is_large & ~is_bent & (local.sum(axis=1) % 2 == 1),
    )


def _points(charts: Charts, chart: Ints, local: Ints, size: Ints, is_bent: Bools) -> Floats:
    """Returns (N, SPOTS, 3) positions on the surface, metres."""
    steps = np.maximum(size - 1, 1)[:, None]
    share = np.where(size[:, None] > 1, (local[:, None] + np.where(is_bent[:, None, None], 0.0, _OFFSETS)) / steps, 0.5)
    inset = np.where(is_bent, _BENT_INSET, _INSET)[:, None, None] / steps
    return interpolate(charts.anchors, chart, np.clip(share, inset, 1 - inset))


def _frames(normals: Floats) -> Floats:
    """Returns frames (N, 3, 3) that depend on the unit normals only, without a jump except at (0, 0, -1).

    Source: Duff et al., Building an Orthonormal Basis, Revisited, JCGT 6(1), 2017.
    """
    x, y, z = normals.T
    sign = np.where(z < 0, -1.0, 1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    along = np.stack((1.0 + sign * x * x * a, sign * b, -sign * x), axis=1)
    across = np.stack((b, sign + y * y * a, -y), axis=1)
    return np.stack((along, across, normals), axis=1)
