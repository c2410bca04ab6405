"""Segments the surface of a scene into flat charts with local frames.

Pure functions. Does not pack them or compute light.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from factory.scenes.light.patches import find_patches
from schemas.support.numpy_types import Floats, Ints
from schemas.support.vectors import cross

_WELD_M = 1e-4
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
    along -= np.einsum("ck,ck->c", along, normals)[:, None] * normals
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.stack((along, cross(normals, along), normals), axis=1)
