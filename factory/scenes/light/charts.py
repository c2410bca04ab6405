"""Finds the flat pieces of a scene's surface, each with a frame of its own; pure, and blind to light and packing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from schemas.support.numpy_types import Floats, Ints

__all__ = ["Charts", "find_charts", "number_rows"]

_WELD_M = 1e-4
_NORMAL_STEP = 1 / 64
_PLANE_STEP_M = 0.02
_PLANE_SHIFT = 0.37  # walls and floors stand at round heights; the limit between two planes must not


@dataclass(frozen=True)
class Charts:
    """Flat pieces, each the rectangle around its triangles; C charts over T triangles."""

    of_triangle: Ints
    """(T,) the chart of each triangle."""
    corners: Floats
    """(T, 3, 2) corners in the frame of their chart, metres, from 0."""
    origin: Floats
    """(C, 3) world place of the rectangle's first corner, metres."""
    axes: Floats
    """(C, 3, 3) rows: along, across, normal; unit vectors."""
    extent: Floats
    """(C, 2) metres along and across."""
    area: Floats
    """(C,) of its triangles, square metres."""


def find_charts(triangles: Floats, groups: Ints) -> Charts:
    """Joins triangles that lie in one plane, touch each other and are of one group.

    Args:
        triangles: (T, 3, 3) corners, world metres.
        groups: (T,) triangles of different groups are never joined.
    """
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    areas = np.linalg.norm(cross, axis=1) / 2
    normals = np.where(areas[:, None] > 1e-14, cross / np.maximum(2 * areas[:, None], 1e-30), (0.0, 0.0, 1.0))
    offsets = np.einsum("tk,tk->t", normals, triangles[:, 0])
    plane = np.column_stack(
        (groups, np.rint(normals / _NORMAL_STEP), np.floor(offsets / _PLANE_STEP_M + _PLANE_SHIFT))
    ).astype(np.int64)
    of_triangle = _touching(triangles, number_rows(plane))
    largest = _largest_of_each(of_triangle, areas)
    axes = _frames(triangles[largest], normals[largest])
    flat = np.einsum("tkc,tac->tka", triangles, axes[of_triangle, :2])
    order = np.argsort(of_triangle, kind="stable")
    starts = np.searchsorted(of_triangle[order], np.arange(len(largest)))
    low = np.minimum.reduceat(flat[order].min(axis=1), starts)
    high = np.maximum.reduceat(flat[order].max(axis=1), starts)
    height = np.einsum("cn,cn->c", axes[:, 2], triangles[largest, 0])
    origin = low[:, :1] * axes[:, 0] + low[:, 1:] * axes[:, 1] + height[:, None] * axes[:, 2]
    return Charts(
        of_triangle=of_triangle,
        corners=flat - low[of_triangle][:, None],
        origin=origin,
        axes=axes,
        extent=high - low,
        area=np.bincount(of_triangle, areas).astype(np.float64),
    )


def number_rows(rows: Ints) -> Ints:
    """Returns (N,) a number for each row of (N, K), equal for equal rows, in the order of their values from 0 on."""
    order = np.lexsort(rows.T[::-1])
    is_new = np.any(rows[order[1:]] != rows[order[:-1]], axis=1)
    numbers = np.empty(len(rows), np.int64)
    numbers[order] = np.concatenate(([0], np.cumsum(is_new)))
    return numbers


def _touching(triangles: Floats, plane: Ints) -> Ints:
    """Numbers the sets of triangles that share corners within their plane."""
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
    """Frames along the middle one of each triangle's edges by length: a side, where the longest is a diagonal."""
    edges = np.roll(triangles, -1, axis=1) - triangles
    middle = np.argsort(np.linalg.norm(edges, axis=2), axis=1, kind="stable")[:, 1]
    along = edges[np.arange(len(edges)), middle]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    spare = np.where(np.abs(normals[:, :1]) < 0.9, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    along = np.where(length > 1e-9, along / np.maximum(length, 1e-30), spare)
    along -= np.einsum("ck,ck->c", along, normals)[:, None] * normals
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.stack((along, np.cross(normals, along), normals), axis=1)
