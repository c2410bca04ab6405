"""Where in the image a target's mask would stand, told from its triangles without drawing.

Every facing bit of surface counts, for what it covers in the image, whatever stands before it. Pure.
"""

from __future__ import annotations

import math

import numpy as np

from schemas.config import CameraConfig
from schemas.encoding.arrays import FRAME_SIZE_PX
from schemas.scene import CompiledScene
from schemas.support.numpy_types import Floats

__all__ = ["Appearance"]

_LONGEST_M = 0.7
"""Triangles with a longer side are cut: each is looked at from its middle alone, and near ends must weigh more."""
_CUTS = 3


class Appearance:
    """The surface of one target; looked at from poses of base_link on the floor."""

    def __init__(self, scene: CompiledScene, instance_id: int, camera: CameraConfig) -> None:
        """Takes the triangles of an instance, heights from the floor.

        Args:
            scene: the place.
            instance_id: of the target.
            camera: of the robot.
        """
        parts = np.flatnonzero((scene.part_instance == instance_id) & (scene.part_count > 0))
        runs = [slice(scene.part_first[part], scene.part_first[part] + scene.part_count[part]) for part in parts]
        corners = np.concatenate([np.zeros((0, 3)), *(scene.positions[run] for run in runs)]).reshape(-1, 3, 3)
        corners[:, :, 2] -= scene.info.floor_height_m
        self._camera = camera
        self._half = math.tan(math.radians(camera.fov_deg) / 2)
        triangles = _cut(corners)
        self._centres: Floats = triangles.mean(axis=1)
        self._faces: Floats = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]) / 2
        """As long as the area."""

    def look(self, x: float, y: float, yaw: float) -> tuple[float, float]:
        """Returns how many pixels the target would cover, and the mean column of its mask.

        Args:
            x: of base_link in the world, metres.
            y: of base_link in the world, metres.
            yaw: radians.

        Returns:
            Pixels, surfaces behind others counted too; and the column from -1 at the left edge to 1 at the right one, 0
            when nothing is in view.
        """
        camera, cos, sin = self._camera, math.cos(yaw), math.sin(yaw)
        eye = (x + camera.x_m * cos - camera.y_m * sin, y + camera.x_m * sin + camera.y_m * cos, camera.z_m)
        ray = self._centres - eye
        depth = ray[:, 0] * cos + ray[:, 1] * sin
        right = ray[:, 0] * sin - ray[:, 1] * cos
        facing = -np.einsum("ij,ij->i", ray, self._faces)
        edge = depth * self._half
        seen = (facing > 0) & (depth > camera.near_m) & (np.abs(right) < edge) & (np.abs(ray[:, 2]) < edge)
        ahead = depth[seen]
        cover = facing[seen] / (ahead * ahead * ahead)  # area on a plane 1 m before the eye
        total = float(cover.sum())
        if total == 0.0:
            return 0.0, 0.0
        pixels = total * (FRAME_SIZE_PX / 2 / self._half) ** 2
        return pixels, float((cover * (right[seen] / edge[seen])).sum()) / total


def _cut(triangles: Floats) -> Floats:
    """Cuts triangles (N, 3, 3) in four, at most `_CUTS` times, until no side is longer than `_LONGEST_M`."""
    for _ in range(_CUTS):
        longest = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max(axis=1, initial=0.0)
        long = triangles[longest > _LONGEST_M]
        if not len(long):
            break
        a, b, c = long[:, 0], long[:, 1], long[:, 2]
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        quarters = [np.stack(corners, axis=1) for corners in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        triangles = np.concatenate([triangles[longest <= _LONGEST_M], *quarters])
    return triangles
