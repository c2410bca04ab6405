"""Casts rays against the triangles of a scene. The only module that uses embreex."""

from __future__ import annotations

from typing import Any

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from numpy.typing import NDArray

from schemas.support.numpy_types import Floats, Singles


class Caster:
    """Ray caster over a set of triangles."""

    def __init__(self, triangles: Floats | Singles) -> None:
        """Builds the acceleration structure of triangles (T, 3, 3), metres."""
        corners = np.ascontiguousarray(triangles, np.float32)
        self._scene: Any = rtcore_scene.EmbreeScene()
        self._mesh: Any = TriangleMesh(self._scene, corners)
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._normals = np.ascontiguousarray(cross.T)

    def first_hits(self, origins: Singles, directions: Singles, reach_m: float) -> tuple[Singles, NDArray[np.bool_]]:
        """Returns the distances (N,) of the first hits, at most `reach_m`, and whether each is a back face.

        Args:
            origins: (N, 3) positions, metres.
            directions: (N, 3) unit vectors.
            reach_m: maximum distance, metres.
        """
        limit = np.full(len(origins), reach_m, np.float32)
        hit = self._scene.run(origins, directions, limit, query="INTERSECT", output=1)
        triangle = np.asarray(hit["primID"])
        has_met = triangle >= 0
        x, y, z = (self._normals[k].take(triangle, mode="clip") * directions[:, k] for k in range(3))
        distance = np.where(has_met, np.asarray(hit["tfar"], np.float32), np.float32(reach_m))
        return distance, has_met & (x + y + z > 0)

    def first_triangles(self, origins: Singles, directions: Singles, lengths_m: Singles) -> NDArray[np.int32]:
        """Returns the number of the triangle that each ray hits first within its length, or -1."""
        return np.asarray(self._scene.run(origins, directions, lengths_m, query="INTERSECT"))

    def is_free(self, origins: Singles, directions: Singles, lengths_m: Singles) -> NDArray[np.bool_]:
        """Returns whether each ray hits nothing within its length."""
        met = np.asarray(self._scene.run(origins, directions, lengths_m, query="OCCLUDED"))  # 0 for a hit, else -1
        return np.asarray(met != 0, np.bool_)
