"""Computes smooth normals of charts that approximate a curved surface. Pure.

Charts that meet at less than a given angle are shaded as one smooth surface; sharper edges stay sharp.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from factory.scenes.light.charts import Charts, number_rows
from schemas.support import portable
from schemas.support.numpy_types import Floats, Ints

__all__ = ["Bends", "corner_normals", "find_bends"]

_ROUND_COS = math.cos(math.radians(46.0))
"""Cosine of the maximum smooth angle: the sides of an octagon are smooth, those of a hexagon are not."""
_MOST_AT_A_CORNER = 64
_MOST_TRIANGLES = 1_000_000
"""Maximum number of triangles with smooth normals; charts of larger scenes are smaller than texels."""
_WELD_M = 1e-4
_BENT_COS = math.cos(math.radians(2.0))
_BENT_SLOPE = 0.08
"""Change of the unit normal along a side above which the side needs at least two texels."""


@dataclass(frozen=True)
class Bends:
    """Linear model of the normal over each of C charts."""

    is_bent: NDArray[np.bool_]
    """(C,) whether the normal varies over the chart."""
    base: Floats
    """(C, 3) unnormalised normal at the first corner of the rectangle of the chart."""
    slope: Floats
    """(C, 2, 3) change of the normal along and across the rectangle."""
    flat: Floats
    """(C, 3) unit normal of the plane of the chart."""
    widest: Floats
    """(C,) tangent of the largest angle between `flat` and the normal of a corner."""

    def normals(self, chart: Ints, share: Floats) -> Floats:
        """Returns the unit normals (N, 3) at positions `share` (N, 2), 0..1, of charts (N,).

        Outside the triangles of a chart, the angle of the normals is limited to that of its corners.
        """
        flat = self.flat[chart]
        normals = self.base[chart] + np.einsum("na,nac->nc", share, self.slope[chart])
        rise = np.maximum(np.einsum("nk,nk->n", normals, flat), 1e-3)[:, None]
        lean = (normals - np.einsum("nk,nk->n", normals, flat)[:, None] * flat) / rise
        size = np.linalg.norm(lean, axis=1, keepdims=True)
        lean *= np.minimum(1.0, self.widest[chart][:, None] / np.maximum(size, 1e-9))
        normals = flat + lean
        return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))

    def least_texels(self) -> Ints:
        """Returns (C, 2) the minimum number of texels of each side that resolves the curvature."""
        strong = np.linalg.norm(self.slope, axis=2) > _BENT_SLOPE
        return np.where(strong & self.is_bent[:, None], 2, 1).astype(np.int64)


def corner_normals(triangles: Floats, groups: Ints) -> Floats:
    """Returns (T, 3, 3) corner normals: the mean over the adjacent triangles that are nearly parallel.

    The mean is weighted by area and by corner angle, so that it does not depend on the triangulation.

    Args:
        triangles: (T, 3, 3) corners, world metres.
        groups: (T,) surfaces of different groups never run on into each other.
    """
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(cross, axis=1)
    flat = cross / np.maximum(length, 1e-30)[:, None]
    places = np.column_stack((np.repeat(groups, 3), np.rint(triangles.reshape(-1, 3) / _WELD_M))).astype(np.int64)
    rows, others = _pairs(number_rows(places))
    here, there = flat[rows // 3], flat[others // 3]
    alike = np.einsum("nk,nk->n", here, there) >= _ROUND_COS
    rows, others, there = rows[alike], others[alike], there[alike]
    weight = (_angles(triangles).reshape(-1) * np.repeat(length, 3))[others]
    total = np.stack([np.bincount(rows, weight * there[:, k], 3 * len(triangles)) for k in range(3)], axis=1)
    size = np.linalg.norm(total, axis=1, keepdims=True)
    normals = np.where(size > 1e-12, total / np.maximum(size, 1e-30), np.repeat(flat, 3, axis=0))
    return np.asarray(normals.reshape(-1, 3, 3))


def _pairs(vertex: Ints) -> tuple[Ints, Ints]:
    """Returns all ordered pairs of corners that share a vertex, with self-pairs; only these for crowded vertices."""
    order = np.argsort(vertex, kind="stable")
    counts = np.bincount(vertex)
    starts = np.cumsum(counts) - counts
    crowded = counts[vertex[order]] > _MOST_AT_A_CORNER
    own = np.where(crowded, 1, counts[vertex[order]])
    rows = np.repeat(np.arange(len(order)), own)
    within = np.arange(len(rows)) - np.repeat(np.cumsum(own) - own, own)
    first = np.where(crowded, np.arange(len(order)), starts[vertex[order]])
    return order[rows].astype(np.int64), order[first[rows] + within].astype(np.int64)


def _angles(triangles: Floats) -> Floats:
    """Returns (T, 3) the inner angle at each corner, radians."""
    after, before = (np.roll(triangles, shift, axis=1) - triangles for shift in (-1, 1))
    sine = np.linalg.norm(np.cross(after, before), axis=2)
    return portable.arctan2(sine, np.einsum("tkc,tkc->tk", after, before))


def find_bends(charts: Charts, triangles: Floats, groups: Ints) -> Bends:
    """Fits a linear model of the normal to each chart.

    Args:
        charts: flat charts.
        triangles: (T, 3, 3) corners, world metres.
        groups: (T,) surfaces of different groups never run on into each other.
    """
    if len(triangles) > _MOST_TRIANGLES:
        corners = np.repeat(charts.axes[charts.of_triangle, 2][:, None], 3, axis=1)
    else:
        corners = corner_normals(triangles, groups)
    count, chart = len(charts.area), np.repeat(charts.of_triangle, 3)
    share = charts.corners / np.maximum(charts.extent, 1e-9)[charts.of_triangle][:, None]
    terms = np.concatenate((np.ones((len(chart), 1)), share.reshape(-1, 2)), axis=1)
    normals = corners.reshape(-1, 3)
    gram = np.stack([np.bincount(chart, terms[:, a] * terms[:, b], count) for a in range(3) for b in range(3)], axis=1)
    right: Floats = np.stack(
        [np.bincount(chart, terms[:, a] * normals[:, k], count) for a in range(3) for k in range(3)], axis=1
    )
    fit = portable.solve(gram.reshape(-1, 3, 3) + 1e-6 * np.eye(3), right.reshape(-1, 3, 3))
    off = np.einsum("nk,nk->n", normals, charts.axes[chart, 2])
    least = np.ones(count)
    np.minimum.at(least, chart, off)
    cosine = np.clip(least, 0.1, 1.0)
    return Bends(least < _BENT_COS, fit[:, 0], fit[:, 1:], charts.axes[:, 2], np.sqrt(1 - cosine**2) / cosine)
