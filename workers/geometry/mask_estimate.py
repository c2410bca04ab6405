"""Estimates the position and size of a target's mask in the image from its triangles, without rendering.

Adds up the image area of all triangles that face the camera. Does not account for occlusion.
"""

from __future__ import annotations

import math

import numpy as np

from schemas.config import CameraConfig
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.scene import CompiledScene
from schemas.support.numpy_types import Floats

_LONGEST_M = 0.7
"""Longest side of a triangle, metres; longer triangles are subdivided, because a triangle is evaluated at its centre
only, and its near part covers more of the image."""
_CUTS = 3


class MaskEstimate:
    """Surface of one target, for evaluation from poses of base_link on the floor."""

    def __init__(self, scene: CompiledScene, instance_id: int, camera: CameraConfig) -> None:
        """Collects the triangles of an instance, with heights above the floor.

        Args:
            scene: scene that contains the target.
            instance_id: id of the target.
            camera: camera of the robot.
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
        """Normal vectors whose length is the area, square metres."""

    def evaluate(self, x: float, y: float, yaw: float) -> tuple[float, float]:
        """Returns an estimate of the size and mean column of the target's mask.

        `workers.experts.observation` computes the exact values from a rendered image.

        Args:
            x: x of base_link in the world, metres.
            y: y of base_link in the world, metres.
            yaw: heading of base_link, radians.

        Returns:
            Number of pixels, occluded surfaces included; and the column from -1 at the left edge to 1 at the right
            edge, 0 if the target is not in view.
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
        cover = facing[seen] / (ahead * ahead * ahead)  # area on a plane 1 m in front of the camera
        total = float(cover.sum())
        if total == 0.0:
            return 0.0, 0.0
        pixels = total * (FRAME_SIZE_PX / 2 / self._half) ** 2
        return pixels, float((cover * (right[seen] / edge[seen])).sum()) / total


def _cut(triangles: Floats) -> Floats:
    """Splits long triangles (N, 3, 3) into four, at most `_CUTS` times, until no side is longer than `_LONGEST_M`."""
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
