"""Maps the charts of a scene onto unit squares, in which light is stored. Pure functions. Does not find charts.

A chart of one triangle or of two that share an edge is mapped corner by corner, so its texels are on the surface
and the light of neighbouring charts is equal along their common edge. Any other chart is mapped by its bounding
rectangle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.support.numpy_types import Floats, Ints
from schemas.support.vectors import cross

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
    found = np.empty((*share.shape[:2], values.shape[2]))
    for spot in range(share.shape[1]):
        found[:, spot] = base + share[:, spot, :1] * along + share[:, spot, 1:] * across
    return found


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
