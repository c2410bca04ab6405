"""Finds the floor triangle below a point, and interpolates vertex values at the point. Pure functions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.scene import CompiledScene
from schemas.support.numpy_types import Floats

_NEAR_M = 0.03
"""Largest vertical distance of a floor triangle from the floor height of the scene, metres."""


class FloorTriangle(NamedTuple):
    """Triangle of the floor."""

    first: int
    """Index of the first vertex of the triangle."""
    part: int
    """Index of the part that contains the triangle."""
    corners: Floats
    """(3, 3) corners, metres."""

    def weights(self, xy: Floats) -> Floats:
        """Returns the weights (N, 3) of the corners at points (N, 2), which may be outside of the triangle."""
        a, b, c = self.corners[:, :2]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        x, y = xy[:, 0], xy[:, 1]
        second = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
        third = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
        return np.stack((1 - second - third, second, third), axis=1)

    def values_at(self, values: NDArray[np.float32], xy: Floats) -> Floats:
        """Returns the values (N, K) at points (N, 2), given the values (V, K) of all vertices of the scene.

        The values at the corners of this triangle are interpolated linearly, and extrapolated outside of it.
        """
        corner_values = values[self.first : self.first + 3].astype(np.float64)
        weights = self.weights(xy)
        return np.asarray((weights[:, :, None] * corner_values[None]).sum(axis=1))


class FloorUnder:
    """Triangles of a scene that form its floor."""

    def __init__(self, scene: CompiledScene) -> None:
        triangles = scene.positions.reshape(-1, 3, 3).astype(np.float64)
        near = (np.abs(triangles[..., 2] - scene.info.floor_height_m) < _NEAR_M).all(axis=1)
        rows = np.flatnonzero(near)
        edges = triangles[rows, 1:, :2] - triangles[rows, :1, :2]
        area = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
        keep = area > 1e-9
        self._rows, self._triangles = rows[keep], triangles[rows[keep]]
        owner = np.repeat(np.arange(len(scene.part_count)), scene.part_count // 3)
        self._parts = owner[self._rows]

    def triangle_at(self, x: float, y: float) -> FloorTriangle | None:
        """Returns the highest floor triangle at a point x, y, metres, or `None` where the scene has no floor."""
        a, b, c = (self._triangles[:, k, :2] for k in range(3))
        inside = np.ones(len(self._triangles), bool)
        for start, end in ((a, b), (b, c), (c, a)):
            inside &= (end[:, 0] - start[:, 0]) * (y - start[:, 1]) >= (end[:, 1] - start[:, 1]) * (x - start[:, 0])
        hits = np.flatnonzero(inside)
        if not len(hits):
            return None
        best = hits[np.argmax(self._triangles[hits, :, 2].max(axis=1))]
        return FloorTriangle(3 * int(self._rows[best]), int(self._parts[best]), self._triangles[best])
