"""Triangulates polygons: a fan for convex faces, ear clipping for concave faces.

Pure functions. Triangles index face corners, so face-varying values can be mapped. Does not read USD.
"""

from __future__ import annotations

from dataclasses import dataclass

import mapbox_earcut
import numpy as np
from numpy.typing import NDArray

from schemas.support.geometry import cross
from schemas.support.numpy_types import Floats, Ints

_NONE = np.zeros((0, 3), np.int64)


@dataclass(frozen=True)
class Triangulation:
    """Triangulation of a mesh, in the order of its faces."""

    corners: Ints
    """(T, 3) indices into the list of face corners."""
    faces: Ints
    """(T,) index of the face of each triangle."""


def triangulate(points: Floats, counts: Ints, indices: Ints) -> Triangulation:
    """Triangulates the faces of a mesh and keeps the winding of each face.

    Args:
        points: (N, 3) vertices in any frame.
        counts: (F,) corners of each face; faces of fewer than three are dropped.
        indices: (C,) vertex of each corner.

    Raises:
        ValueError: counts and indices do not match, or an index is out of range.
    """
    if counts.sum() != len(indices) or (counts < 0).any():
        raise ValueError(f"bad topology: the faces need {counts.sum()} corners, but the mesh has {len(indices)}")
    if len(indices) and (indices.min() < 0 or indices.max() >= len(points)):
        raise ValueError(
            f"bad topology: vertices {indices.min()} to {indices.max()} (from 0) are used, but there are {len(points)}"
        )
    starts = np.cumsum(counts) - counts
    corners, faces = [_NONE], [np.zeros(0, np.int64)]
    for size in np.unique(counts[counts >= 3]):
        rows = np.flatnonzero(counts == size)
        cut, owner = _cut_faces(points, indices, starts[rows], int(size))
        corners.append(cut)
        faces.append(rows[owner])
    face = np.concatenate(faces)
    order = np.argsort(face, kind="stable")
    return Triangulation(np.concatenate(corners)[order], face[order])


def _cut_faces(points: Floats, indices: Ints, starts: Ints, size: int) -> tuple[Ints, Ints]:
    """Triangulates faces of one size. Returns corners (T, 3) and the row of `starts` of each triangle."""
    corners = starts[:, None] + np.arange(size)
    steps = np.arange(1, size - 1)
    fan = np.stack([np.zeros_like(steps), steps, steps + 1], axis=1)
    concave = _concave(points[indices[corners]]) if size > 3 else np.zeros(len(starts), bool)
    convex = np.flatnonzero(~concave)
    cuts = [corners[convex][:, fan].reshape(-1, 3)]
    owners = [np.repeat(convex, len(fan))]
    for row in np.flatnonzero(concave):
        ears = _ears(points[indices[corners[row]]])
        ears = fan if len(ears) == 0 else ears
        cuts.append(corners[row][ears])
        owners.append(np.full(len(ears), row))
    return np.concatenate(cuts), np.concatenate(owners)


def _normals(polygons: Floats) -> Floats:
    """Returns area-weighted normals (F, 3) of polygons (F, n, 3)."""
    centred = polygons - polygons.mean(axis=1, keepdims=True)
    normals: Floats = cross(centred, np.roll(centred, -1, axis=1)).sum(axis=1)
    return normals


def _concave(polygons: Floats) -> NDArray[np.bool_]:
    """Returns the mask (F,) of concave polygons (F, n, 3)."""
    normals = _normals(polygons)
    area = np.linalg.norm(normals, axis=1)
    edges = np.roll(polygons, -1, axis=1) - polygons
    turns = np.einsum("fnk,fk->fn", cross(edges, np.roll(edges, -1, axis=1)), normals)
    concave: NDArray[np.bool_] = (area > 1e-14) & (turns < -1e-9 * (area**2)[:, None]).any(axis=1)
    return concave


def _ears(polygon: Floats) -> Ints:
    """Returns the triangles (T, 3), as corner indices, of one concave polygon (n, 3), with its winding."""
    normal = _normals(polygon[None])[0]
    normal /= np.linalg.norm(normal)
    across = cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    across /= np.linalg.norm(across)
    flat = np.stack([polygon @ across, polygon @ cross(normal, across)], axis=1)
    ends = np.array([len(flat)], np.uint32)
    ears = mapbox_earcut.triangulate_float64(np.ascontiguousarray(flat), ends).reshape(-1, 3).astype(np.int64)
    a, b, c = flat[ears[:, 0]], flat[ears[:, 1]], flat[ears[:, 2]]
    turned = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] < 0
    ears[turned] = ears[turned][:, ::-1]
    return ears


def is_closed(triangles: Ints) -> bool:
    """Returns whether triangles (T, 3) bound a volume: each edge occurs once in each direction."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    forth = np.sort(edges[:, 0] << 32 | edges[:, 1])
    back = np.sort(edges[:, 1] << 32 | edges[:, 0])
    return len(edges) > 0 and bool((forth == back).all()) and bool((np.diff(forth) != 0).all())


def bounds_volume(points: Floats, triangles: Ints) -> bool:
    """Returns whether the triangles, with equal points merged, bound a volume with outward winding."""
    _, welded = np.unique(points, axis=0, return_inverse=True)
    if not is_closed(welded.reshape(-1)[triangles]):
        return False
    a, b, c = np.moveaxis(points[triangles] - points[0], 1, 0)
    return float(np.einsum("ij,ij->", a, cross(b, c))) > 0
