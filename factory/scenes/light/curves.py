"""Computes smooth normals of charts that approximate a curved surface. Pure functions.

Charts that meet at less than a given angle are shaded as one smooth surface; sharper edges stay sharp.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from factory.scenes.light.charts import SQUARE, Charts, interpolate, number_rows
from schemas.support import portable
from schemas.support.geometry import cross
from schemas.support.numpy_types import Floats, Ints

_ROUND_COS = math.cos(math.radians(46.0))
"""Cosine of the largest angle between faces that are shaded as one smooth surface. The sides of an octagon are smooth,
those of a hexagon are not."""
_MOST_AT_A_CORNER = 64
_MOST_TRIANGLES = 1_000_000
"""Scenes with more triangles get flat normals, because their charts are smaller than texels."""
_WELD_M = 1e-4
_BENT_COS = math.cos(math.radians(2.0))
_AT_CORNER = 1e-6
_BENT_SLOPE = 0.08
"""A side of a chart gets at least two texels if the unit normal changes by more than this along the side."""


@dataclass(frozen=True)
class Bends:
    """Model of the normal over each of C charts."""

    is_bent: NDArray[np.bool_]
    """(C,) whether the normal varies over the chart."""
    corners: Floats
    """(C, 4, 3) normals at the corners of the square of the chart, not normalised."""

    def normals(self, chart: Ints, share: Floats) -> Floats:
        """Returns the unit normals (N, 3) at positions `share` (N, 2), 0..1, of charts (N,)."""
        normals = interpolate(self.corners, chart, share[:, None])[:, 0]
        return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9))

    def least_texels(self) -> Ints:
        """Returns (C, 2) the minimum number of texels of each side that resolves the curvature."""
        change = np.linalg.norm(np.roll(self.corners, -1, axis=1) - self.corners, axis=2)
        strong = np.maximum(change[:, :2], change[:, 2:]) > _BENT_SLOPE
        return np.where(strong & self.is_bent[:, None], 2, 1).astype(np.int64)


def corner_normals(triangles: Floats, groups: Ints) -> Floats:
    """Returns (T, 3, 3) corner normals: the mean over the adjacent triangles that are nearly parallel.

    The mean is weighted by area and by corner angle, so it does not depend on the triangulation.

    Args:
        triangles: (T, 3, 3) corners, world metres.
        groups: (T,) group of each triangle; normals are not smoothed across groups.
    """
    product = cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(product, axis=1)
    flat = product / np.maximum(length, 1e-30)[:, None]
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
    """Returns all ordered pairs of corners that share a vertex, including self-pairs.

    At vertices with more than `_MOST_AT_A_CORNER` corners, there are only self-pairs.
    """
    order = np.argsort(vertex, kind="stable")
    counts = np.bincount(vertex)
    starts = np.cumsum(counts) - counts
    crowded = counts[vertex[order]] > _MOST_AT_A_CORNER
    weights = np.where(crowded, 1, counts[vertex[order]])
    rows = np.repeat(np.arange(len(order)), weights)
    within = np.arange(len(rows)) - np.repeat(np.cumsum(weights) - weights, weights)
    first = np.where(crowded, np.arange(len(order)), starts[vertex[order]])
    return order[rows].astype(np.int64), order[first[rows] + within].astype(np.int64)


def _angles(triangles: Floats) -> Floats:
    """Returns (T, 3) the inner angle at each corner, radians."""
    after, before = (np.roll(triangles, shift, axis=1) - triangles for shift in (-1, 1))
    sine = np.linalg.norm(cross(after, before), axis=2)
    return portable.arctan2(sine, np.einsum("tkc,tkc->tk", after, before))


def find_bends(charts: Charts, triangles: Floats, groups: Ints) -> Bends:
    """Determines the normal at each corner of each chart: that of the vertex there, or else the value of a linear fit.

    Args:
        charts: flat charts.
        triangles: (T, 3, 3) corners, world metres.
        groups: (T,) group of each triangle; normals are not smoothed across groups.
    """
    # normals make the light of round surfaces smooth: an average of the light over neighbouring charts shows seams, and
    # smooth light from the shader takes time in each frame
    if len(triangles) > _MOST_TRIANGLES:
        corners = np.repeat(charts.axes[charts.of_triangle, 2][:, None], 3, axis=1)
    else:
        corners = corner_normals(triangles, groups)
    chart, normals = np.repeat(charts.of_triangle, 3), corners.reshape(-1, 3)
    flat, share = charts.axes[:, 2], charts.share.reshape(-1, 2)
    off = np.einsum("nk,nk->n", normals, flat[chart])
    least = np.ones(len(flat))
    np.minimum.at(least, chart, off)
    fitted = _no_steeper(_fit(normals, chart, share, len(flat)), flat, np.clip(least, 0.1, 1.0))
    for number, corner in enumerate(SQUARE):
        rows = np.flatnonzero((np.abs(share - corner) < _AT_CORNER).all(axis=1))
        fitted[chart[rows], number] = normals[rows]
    return Bends(least < _BENT_COS, fitted)


def _fit(normals: Floats, chart: Ints, share: Floats, count: int) -> Floats:
    """Fits a linear function of the position to the normals (N, 3); returns its values at the corners of charts."""
    terms = np.concatenate((np.ones((len(chart), 1)), share), axis=1)
    gram = np.stack([np.bincount(chart, terms[:, a] * terms[:, b], count) for a in range(3) for b in range(3)], axis=1)
    right: Floats = np.stack(
        [np.bincount(chart, terms[:, a] * normals[:, k], count) for a in range(3) for k in range(3)], axis=1
    )
    fit = portable.solve(gram.reshape(-1, 3, 3) + 1e-6 * np.eye(3), right.reshape(-1, 3, 3))
    return np.asarray(fit[:, :1] + np.einsum("ka,can->ckn", SQUARE, fit[:, 1:]))


def _no_steeper(normals: Floats, flat: Floats, cosine: Floats) -> Floats:
    """Limits the angle of normals (C, 4, 3) to plane normals `flat` (C, 3); `cosine` (C,) is that of the limit."""
    rise = np.maximum(np.einsum("ckn,cn->ck", normals, flat), 1e-3)[..., None]
    lean = normals / rise - flat[:, None]
    lean -= np.einsum("ckn,cn->ck", lean, flat)[..., None] * flat[:, None]
    size = np.linalg.norm(lean, axis=2, keepdims=True)
    widest = (np.sqrt(1 - cosine**2) / cosine)[:, None, None]
    return np.asarray(flat[:, None] + lean * np.minimum(1.0, widest / np.maximum(size, 1e-9)))
