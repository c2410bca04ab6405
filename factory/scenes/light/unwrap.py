"""Packs the flat charts of a scene as rectangles of texels into the light map. Pure functions.

The outermost texel centres are on the edges of the chart, so bilinear sampling does not read other charts and
needs no padding. Small charts of a curved surface get two texels per side, so light is continuous across edges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factory.scenes.light.charts import Charts
from schemas.support.numpy_types import Floats, Ints

_TEXELS_PER_M = 12.0
_FLOOR_GAIN, _CEILING_GAIN = 2.4, 0.4
_LARGE_M2 = 4.0
_BUDGET = 512_000
_MAX_SIDE = 1024
_TINY = 0.75
"""A chart gets a single texel along each of its sides that is shorter than this, texels."""


class TooManyPieces(ValueError):
    """The scene has more charts than the light map has texels."""


@dataclass(frozen=True)
class Unwrap:
    """Layout of the charts in the light map."""

    shape: tuple[int, int]
    """Rows and columns of the light map."""
    place: Ints
    """(C, 2) first column and first row of each chart."""
    size: Ints
    """(C, 2) columns and rows of each chart."""
    uvs: Floats
    """(T, 3, 2) light map coordinates of the corners, 0..1."""


def unwrap(
    charts: Charts, gain: Floats | None = None, least: Ints | None = None, width: int = 1024, max_height: int = 2048
) -> Unwrap:
    """Packs the charts into one light map at the highest density that fits.

    Args:
        charts: flat charts.
        gain: (C,) relative texel density of each chart; 1 when `None`, 0 for a single texel.
        least: (C, 2) minimum number of texels along and across; 1 when `None`.
        width: number of columns of the light map.
        max_height: maximum number of rows of the light map.
    """
    wanted = _density(charts) * (1.0 if gain is None else gain)
    floor = np.ones((len(wanted), 2), np.int64) if least is None else np.where(wanted[:, None] > 0, least, 1)
    scale = 1.0
    while True:
        size = np.maximum(_sizes(charts.extent, wanted * scale, min(width, _MAX_SIDE)), floor)
        place, height = _pack(size, width)
        if height <= max_height and size.prod(axis=1).sum() <= max(_BUDGET, 2 * len(size)):
            break
        if size.max() == 1:
            raise TooManyPieces(f"{len(size)} flat pieces do not fit {width} x {max_height} texels")
        if (size == floor).all():
            floor = np.ones_like(floor)  # the last resort: curved surfaces with one texel across look faceted
        scale *= 0.9
    chart = charts.of_triangle
    texel = place[chart][:, None] + 0.5 + charts.share * (size[chart] - 1)[:, None]
    return Unwrap((height, width), place, size, texel / (width, height))


def _density(charts: Charts) -> Floats:
    """Returns texels per metre: more on large floors, which have contact shadows, fewer on ceilings."""
    up, is_large = charts.axes[:, 2, 2], charts.area >= _LARGE_M2
    gain = np.where(is_large & (up > 0.9), _FLOOR_GAIN, np.where(is_large & (up < -0.9), _CEILING_GAIN, 1.0))
    return np.asarray(_TEXELS_PER_M * gain)


def _sizes(extent: Floats, density: Floats, most: int) -> Ints:
    texels = extent * density[:, None]
    return np.where(texels < _TINY, 1, np.minimum(np.ceil(texels) + 1, most)).astype(np.int64)


def _pack(size: Ints, width: int) -> tuple[Ints, int]:
    """Shelf packing, highest charts first. Returns positions and the height used."""
    order = np.lexsort((-size[:, 0], -size[:, 1]))
    column = row = shelf = 0
    places = []
    for wide, high in size[order].tolist():
        if column + wide > width:
            column, row, shelf = 0, row + shelf, 0
        places.append((column, row))
        column, shelf = column + wide, max(shelf, high)
    place = np.zeros_like(size)
    place[order] = places
    return place, row + shelf
