"""Segments the surface of a scene into flat charts, and packs them as rectangles of texels into the light map.

A chart of one triangle or of two that share an edge is mapped corner by corner, so its texels are on the surface and
the light of neighbouring charts is equal along their common edge. Any other chart is mapped by its bounding rectangle.
The outermost texel centres are on the edges of the chart, so bilinear sampling needs no padding. The library xatlas
takes about twenty times as long for the office, and needs padding. Pure functions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from schemas.support.geometry import cross
from schemas.support.numpy_types import Floats, Ints

_WELD_M = 1e-4
_RECTANGULAR = 0.98
"""Two triangles form a rectangle if they cover more than this share of their bounding rectangle."""
SQUARE = np.array(((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)))
"""Corners of the unit square, in the order of `Patches.anchors`."""


@dataclass(frozen=True)
class Patches:
    """Maps of C charts over T triangles; the square has the corners (0, 0), (1, 0), (1, 1), (0, 1)."""

    share: Floats
    """(T, 3, 2) position of each corner of a triangle in the square of its chart, 0..1."""
    anchors: Floats
    """(C, 4, 3) world positions of the corners of the square, metres."""
    extent: Floats
    """(C, 2) length along and across, metres: that of the longer of the two opposite sides."""


def interpolate(values: Floats, chart: Ints, share: Floats) -> Floats:
    """Interpolates values linearly at S positions, which are close together, in the square of each of N charts.

    Returns (N, S, K). The diagonal divides the square into two triangles, each with its own linear function.

    Args:
        values: (C, 4, K) values at the corners of the squares.
        chart: (N,) chart of each position.
        share: (N, S, 2) positions in the square, 0..1. The first position of a chart determines the triangle for all S
            positions.
    """
    first, second, third, fourth = values.swapaxes(0, 1)
    along, across = np.stack((second - first, third - fourth)), np.stack((third - second, fourth - first))
    side = (share[:, 0, 0] < share[:, 0, 1]).astype(np.int64)
    base, along, across = first[chart], along[side, chart], across[side, chart]
    result = np.empty((*share.shape[:2], values.shape[2]))
    for spot in range(share.shape[1]):
        result[:, spot] = base + share[:, spot, :1] * along + share[:, spot, 1:] * across
    return result


def find_patches(triangles: Floats, of_triangle: Ints, axes: Floats) -> Patches:
    """Maps each chart onto the unit square.

    Args:
        triangles: (T, 3, 3) corners, world metres.
        of_triangle: (T,) chart of each triangle.
        axes: (C, 3, 3) frame of each chart: along, across, normal.
    """
    order = np.argsort(of_triangle, kind="stable")
    starts = np.searchsorted(of_triangle[order], np.arange(len(axes)))
    counts = np.bincount(of_triangle, minlength=len(axes))
    patches = _rectangles(triangles, of_triangle, axes, order, starts)
    alone = np.flatnonzero(counts == 1)
    _map_triangles(patches, triangles, order[starts[alone]], alone)
    two = np.flatnonzero(counts == 2)
    _map_pairs(patches, triangles, np.column_stack((order[starts[two]], order[starts[two] + 1])), two)
    return patches


def _rectangles(triangles: Floats, of_triangle: Ints, axes: Floats, order: Ints, starts: Ints) -> Patches:
    flat = np.einsum("tkc,tac->tka", triangles, axes[of_triangle, :2])
    low = np.minimum.reduceat(flat[order].min(axis=1), starts)
    extent = np.maximum.reduceat(flat[order].max(axis=1), starts) - low
    height = np.einsum("cn,cn->c", axes[:, 2], triangles[order[starts], 0])
    place = low[:, None] + SQUARE * extent[:, None]
    anchors = np.einsum("cka,can->ckn", place, axes[:, :2]) + (height[:, None] * axes[:, 2])[:, None]
    share = (flat - low[of_triangle][:, None]) / np.maximum(extent, 1e-9)[of_triangle][:, None]
    return Patches(np.clip(share, 0.0, 1.0), anchors, extent)


def _map_triangles(patches: Patches, triangles: Floats, rows: Ints, charts: Ints) -> None:
    """Maps single triangles with their longest edge on the diagonal; the fourth corner completes a parallelogram."""
    longest = np.linalg.norm(np.roll(triangles[rows], -1, axis=1) - triangles[rows], axis=2).argmax(axis=1)
    turned = (longest[:, None] + (1, 2, 3)) % 3
    first, second, third = (triangles[rows, turned[:, k]] for k in range(3))
    _set(patches, charts, np.stack((first, second, third, first + third - second), axis=1))
    for k in range(3):
        patches.share[rows, turned[:, k]] = SQUARE[k]


def _map_pairs(patches: Patches, triangles: Floats, rows: Ints, charts: Ints) -> None:
    """Maps pairs of triangles (N, 2) that share exactly one edge and do not form a rectangle."""
    one, other = triangles[rows[:, 0]], triangles[rows[:, 1]]
    meets = np.linalg.norm(one[:, :, None] - other[:, None], axis=3) < _WELD_M
    area = np.linalg.norm(cross(one[:, 1] - one[:, 0], one[:, 2] - one[:, 0]), axis=1) / 2
    area += np.linalg.norm(cross(other[:, 1] - other[:, 0], other[:, 2] - other[:, 0]), axis=1) / 2
    fits = (meets.sum(axis=(1, 2)) == 2) & (meets.any(axis=2).sum(axis=1) == 2) & (meets.any(axis=1).sum(axis=1) == 2)
    chosen = np.flatnonzero(fits & (area < _RECTANGULAR * patches.extent[charts].prod(axis=1)))
    rows, one, other, meets = rows[chosen], one[chosen], other[chosen], meets[chosen]
    turned = ((~meets.any(axis=2)).argmax(axis=1)[:, None] + (2, 0, 1)) % 3
    far = (~meets.any(axis=1)).argmax(axis=1)
    each = np.arange(len(rows))
    corners = [one[each, turned[:, k]] for k in range(3)]
    _set(patches, charts[chosen], np.stack((*corners, other[each, far]), axis=1))
    for k in range(3):
        patches.share[rows[:, 0], turned[:, k]] = SQUARE[k]
        touching = np.flatnonzero(meets[each, turned[:, k]].any(axis=1))
        patches.share[rows[touching, 1], meets[touching, turned[touching, k]].argmax(axis=1)] = SQUARE[k]
    patches.share[rows[:, 1], far] = SQUARE[3]


def _set(patches: Patches, charts: Ints, corners: Floats) -> None:
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    patches.anchors[charts] = corners
    patches.extent[charts] = np.maximum(sides[:, :2], sides[:, 2:])


_NORMAL_STEP = 1 / 64
_PLANE_STEP_M = 0.02
_PLANE_SHIFT = 0.37  # so walls and floors at round coordinates are not on the boundary of two steps


@dataclass(frozen=True)
class Charts:
    """C flat charts over T triangles, each mapped onto a unit square."""

    of_triangle: Ints
    """(T,) chart index of each triangle."""
    share: Floats
    """(T, 3, 2) corners in the square of their chart, 0..1."""
    anchors: Floats
    """(C, 4, 3) world positions of the corners (0, 0), (1, 0), (1, 1), (0, 1) of the square, metres."""
    axes: Floats
    """(C, 3, 3) rows: along, across, normal; unit vectors."""
    extent: Floats
    """(C, 2) size along and across, metres."""
    area: Floats
    """(C,) area of the triangles, square metres."""


def find_charts(triangles: Floats, groups: Ints) -> Charts:
    """Joins coplanar, touching triangles of one group into charts.

    Args:
        triangles: (T, 3, 3) corners, world metres.
        groups: (T,) group of each triangle; triangles of different groups are not joined.
    """
    product = cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    areas = np.linalg.norm(product, axis=1) / 2
    normals = np.where(areas[:, None] > 1e-14, product / np.maximum(2 * areas[:, None], 1e-30), (0.0, 0.0, 1.0))
    offsets = np.einsum("tk,tk->t", normals, triangles[:, 0])
    plane = np.column_stack(
        (groups, np.rint(normals / _NORMAL_STEP), np.floor(offsets / _PLANE_STEP_M + _PLANE_SHIFT))
    ).astype(np.int64)
    of_triangle = _touching(triangles, number_rows(plane))
    largest = _largest_of_each(of_triangle, areas)
    axes = _frames(triangles[largest], normals[largest])
    patches = find_patches(triangles, of_triangle, axes)
    return Charts(
        of_triangle=of_triangle,
        share=patches.share,
        anchors=patches.anchors,
        axes=axes,
        extent=patches.extent,
        area=np.bincount(of_triangle, areas).astype(np.float64),
    )


def number_rows(rows: Ints) -> Ints:
    """Returns (N,) the index of each row of (N, K) in the sorted list of distinct rows."""
    order = np.lexsort(rows.T[::-1])
    is_new = np.any(rows[order[1:]] != rows[order[:-1]], axis=1)
    numbers = np.empty(len(rows), np.int64)
    numbers[order] = np.concatenate(([0], np.cumsum(is_new)))
    return numbers


def _touching(triangles: Floats, plane: Ints) -> Ints:
    """Returns the connected component of each triangle. Triangles of one plane that share a corner are connected."""
    count = len(triangles)
    corners = number_rows(np.rint(triangles.reshape(-1, 3) / _WELD_M).astype(np.int64))
    nodes = number_rows(np.column_stack((corners, np.repeat(plane, 3))))
    rows = np.repeat(np.arange(count), 3)
    graph = sparse.coo_matrix(
        (np.ones(3 * count, np.int8), (rows, nodes + count)), shape=(count + nodes.max() + 1,) * 2
    )
    labels = connected_components(graph, directed=False)[1][:count]
    return np.unique(labels, return_inverse=True)[1].reshape(-1).astype(np.int64)


def _largest_of_each(of_triangle: Ints, areas: Floats) -> Ints:
    order = np.lexsort((-areas, of_triangle))
    starts = np.searchsorted(of_triangle[order], np.arange(of_triangle.max() + 1))
    return np.asarray(order[starts], np.int64)


def _frames(triangles: Floats, normals: Floats) -> Floats:
    """Returns a frame for each triangle, along its second longest edge; the longest may be a diagonal."""
    edges = np.roll(triangles, -1, axis=1) - triangles
    middle = np.argsort(np.linalg.norm(edges, axis=2), axis=1, kind="stable")[:, 1]
    along = edges[np.arange(len(edges)), middle]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    spare = np.where(np.abs(normals[:, :1]) < 0.9, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    along = np.where(length > 1e-9, along / np.maximum(length, 1e-30), spare)
    flat = along - np.einsum("ck,ck->c", along, normals)[:, None] * normals
    # the normal of a face without area is arbitrary, and its edges may be parallel to the one that it was given
    is_steep = np.linalg.norm(flat, axis=1, keepdims=True) < 1e-9
    other = spare - np.einsum("ck,ck->c", np.asarray(spare), normals)[:, None] * normals
    along = np.where(is_steep, other, flat)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.stack((along, cross(normals, along), normals), axis=1)


_TEXELS_PER_M = 12.0
_FLOOR_GAIN, _CEILING_GAIN = 2.4, 0.4
"""Density of the texels of large floors and ceilings, relative to other surfaces."""
# a texel is 3.5 cm wide on a floor, so it shows a contact shadow, whose light changes over 6.5 cm (`_FADE_M` in
# `bake.py`); with the 8.3 cm of other surfaces it would not. Ceilings have no such shadows
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
