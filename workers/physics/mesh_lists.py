"""Meshes as the plain lists that PyBullet reads, and those lists used again; knows nothing of PyBullet itself."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["MESH_TRIANGLES", "MeshLists", "as_lists", "mesh_lists", "recycle", "take_back"]

MESH_TRIANGLES = 40_000
"""Most triangles a shape is given; Bullet refuses more than 131072 vertices or 524288 indices."""

_spare: list[list[float]] = []
"""Vertices of meshes that are no longer needed."""


class MeshLists(NamedTuple):
    """A piece of a mesh as the plain lists PyBullet reads fastest; within the limits of one shape.

    PyBullet never lets go of a list it was given, so `recycle` what is no longer needed.
    """

    vertices: list[list[float]]
    indices: list[int]


def mesh_lists(vertices: NDArray[np.float32], triangles: NDArray[np.int32]) -> tuple[MeshLists, ...]:
    """Cuts an indexed mesh into pieces that a shape can hold.

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
    """Takes back the lists of a mesh that no world will be built from any more, and leaves it empty.

    `createCollisionShape` and `createVisualShape` keep a reference to every list for good: 5 MB for each load of a
    warehouse. So the next mesh is written into the same lists.
    """
    for piece in pieces:
        take_back(piece.vertices)
        piece.indices.clear()


def take_back(lists: list[list[float]]) -> None:
    """Empties a list of rows, and keeps the rows for the next mesh."""
    _spare.extend(lists)
    lists.clear()


def as_lists(points: NDArray[np.float32]) -> list[list[float]]:
    """Returns the rows of (N, K) points as lists, those that were taken back first."""
    lists: list[list[float]] = points.tolist()
    for row in range(min(len(lists), len(_spare))):
        spare = _spare.pop()
        spare[:] = lists[row]
        lists[row] = spare
    return lists
