"""Converts meshes to the lists that PyBullet reads, and reuses these lists. Does not use PyBullet."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

MESH_TRIANGLES = 40_000
"""Largest number of triangles in a shape; Bullet rejects more than 131072 vertices or 524288 indices."""

_spare: list[list[float]] = []
"""Rows of recycled lists, available for the next mesh."""


class MeshLists(NamedTuple):
    """Piece of a mesh within the limits of one shape, as lists, which PyBullet reads fastest.

    PyBullet keeps a reference to every list, so call `recycle` for lists that are no longer needed.
    """

    vertices: list[list[float]]
    """Vertices x, y, z, metres."""
    indices: list[int]
    """Vertex indices, three for each triangle."""


def mesh_lists(vertices: NDArray[np.float32], triangles: NDArray[np.int32]) -> tuple[MeshLists, ...]:
    """Splits an indexed mesh into pieces within the limits of one shape.

    Args:
        vertices: (M, 3) metres.
        triangles: (K, 3) indices into `vertices`.
    """
    pieces = []
    for first in range(0, len(triangles), MESH_TRIANGLES):
        used, local = np.unique(triangles[first : first + MESH_TRIANGLES], return_inverse=True)
        pieces.append(MeshLists(as_lists(vertices[used]), local.ravel().tolist()))
    return tuple(pieces)


def recycle(pieces: tuple[MeshLists, ...]) -> None:
    """Empties the lists of a mesh that is no longer needed, and keeps their rows for the next mesh.

    `createCollisionShape` and `createVisualShape` never release the reference to a list, which costs 5 MB for each load
    of a warehouse. So the next mesh reuses the same lists.
    """
    for piece in pieces:
        take_back(piece.vertices)
        piece.indices.clear()


def take_back(lists: list[list[float]]) -> None:
    """Empties a list of rows and keeps the rows for the next mesh."""
    _spare.extend(lists)
    lists.clear()


def as_lists(points: NDArray[np.float32]) -> list[list[float]]:
    """Returns the rows of (N, K) points as lists; reuses the rows of recycled lists first."""
    lists: list[list[float]] = points.tolist()
    for row in range(min(len(lists), len(_spare))):
        spare = _spare.pop()
        spare[:] = lists[row]
        lists[row] = spare
    return lists
