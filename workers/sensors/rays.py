"""Casts rays against the triangles that renderers draw: front faces of all parts, without the robot. Opens no scene."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.scene import CompiledScene
from schemas.support.numpy_types import Bools, Floats, Singles
from workers.geometry.rays import Caster
from workers.sensors.lidar import RayHits

_SAME_M = np.float32(1e-4)
"""Distance below which two faces count as being at the same place, metres."""
_BEHIND_M = np.geomspace(1e-4, 1e-2, 16)
"""Distance behind the first, second, ... back face from which a ray continues, metres. The distance grows, so
a ray that grazes a face gets past it. A ray that meets more back faces than this hits nothing."""
_TILTED = np.array((0.58, 0.21, 0.79))
"""Direction that is not parallel to the faces of usual objects."""


class SceneRays:
    """Ray caster of a compiled scene."""

    def __init__(self, scene: CompiledScene) -> None:
        """Builds the acceleration structure."""
        counts = scene.part_count // 3
        firsts = np.repeat(scene.part_first - 3 * (np.cumsum(counts) - counts), counts) + 3 * np.arange(counts.sum())
        triangles = scene.positions[firsts[:, None] + np.arange(3)]
        normals = _unit_normals(triangles)
        self._ids = np.repeat(scene.part_instance, counts)
        self._planes = np.stack((*normals.T, _dot(normals.T, triangles[:, 0].T.astype(np.float64))))
        self._is_two_sided = _two_sided(triangles, normals)
        self._caster = Caster(triangles)

    def nearest(self, origins: Floats, directions: Floats, reach_m: float) -> RayHits:
        """Returns the first hit of each of N rays; see `RayCaster`.

        A renderer draws front faces only, so a ray passes through a back face. Embree finds the triangle; the distance
        is computed from its plane in float64, so it does not depend on the processor.
        """
        eyes, ways = origins.astype(np.float32), directions.astype(np.float32)
        lengths = np.full(len(eyes), reach_m, np.float32)
        triangles = self._caster.first_triangles(eyes, ways, lengths)
        distances, slants = self._meet(triangles, origins, directions)
        passed = self._backs(triangles, slants)
        for behind in _BEHIND_M:
            if not len(passed):
                break
            gone = (distances[passed] + behind).astype(np.float32)
            eyes[passed] = origins[passed] + gone[:, None] * ways[passed]
            met = self._caster.first_triangles(eyes[passed], ways[passed], lengths[passed] - gone)
            triangles[passed] = met
            distances[passed], slants[passed] = self._meet(met, origins[passed], directions[passed])
            passed = passed[self._backs(met, slants[passed])]
        triangles[passed] = -1
        is_hit = triangles >= 0
        ids = self._ids.take(triangles, mode="clip") * is_hit
        return RayHits((distances * is_hit).astype(np.float32), ids, (np.abs(slants) * is_hit).astype(np.float32))

    def _meet(self, met: NDArray[np.int32], origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
        """Returns distances (N,) to the planes of triangles, and scalar products (N,) of their normals and
        directions."""
        # in float64 from the planes: Embree's own distances are float32, and their last bits differ between processors
        *normals, offsets = (row.take(met, mode="clip") for row in self._planes)
        slants = _dot(normals, directions.T)
        height = offsets - _dot(normals, origins.T)
        return np.divide(height, slants, out=np.zeros_like(height), where=slants != 0), slants

    def _backs(self, met: NDArray[np.int32], slants: Floats) -> NDArray[np.intp]:
        """Returns the numbers of the rays that met a back face, which is not drawn."""
        return np.flatnonzero((slants > 0) & (met >= 0) & ~self._is_two_sided.take(met, mode="clip"))


def _unit_normals(triangles: Singles) -> Floats:
    edges = np.diff(triangles.astype(np.float64), axis=1)
    normals = np.cross(edges[:, 0], edges[:, 1])
    return np.asarray(normals / np.maximum(np.sqrt((normals**2).sum(axis=1, keepdims=True)), 1e-30))


def _two_sided(triangles: Singles, normals: Floats) -> Bools:
    """Returns whether another triangle at the place of each triangle faces the other way, as in a sheet of paper."""
    is_two_sided, is_first = np.zeros(len(triangles), bool), _dot(normals.T, _TILTED) > 0
    for half in (is_first, ~is_first):
        half_normals, others = normals[half].astype(np.float32), triangles[~half]
        if len(half_normals) and len(others):
            centres = triangles[half].mean(axis=1) + _SAME_M * half_normals
            met = Caster(others).first_triangles(
                centres, -half_normals, np.full(len(half_normals), 2 * _SAME_M, np.float32)
            )
            is_two_sided[half] = (met >= 0) & (_dot(normals[~half][met].T, half_normals.T) < -0.99)
    return is_two_sided


def _dot(left: Floats | Sequence[Floats], right: Floats | Singles) -> Floats:
    """Returns the scalar products (N,) of vectors, given as coordinates (3, N) or (3,)."""
    return np.asarray(left[0] * right[0] + left[1] * right[1] + left[2] * right[2])
