"""Geometry of the robot's pinhole camera: pose, view matrix, projection matrix and intrinsics.

Pure functions in float64. Does not render and uses no graphics library.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.config import CameraConfig
from schemas.support.portable import product
from workers.geometry.pose import Pose

Matrix = NDArray[np.float64]


_OPTICAL_AXES, _OPTICAL_SIGNS = [1, 2, 0], np.array((-1.0, -1.0, 1.0))
"""Right, down and forward, as columns of a rotation of base_link, whose axes are forward, left and up."""


@dataclass(frozen=True, slots=True)
class OpticalPose:
    """Pose of the optical frame (x right, y down, z forward) in the world frame."""

    eye: Matrix
    """(3,) projection centre, metres."""
    rotation: Matrix
    """(3, 3) rotation matrix; its columns are the optical axes x, y, z as unit vectors in the world frame."""


def optical_pose(pose: Pose, camera: CameraConfig) -> OpticalPose:
    """Returns the pose of the optical frame for a pose of base_link; the optical axis is parallel to base_link's x."""
    base = _rotation(pose)
    eye = product(base, np.array(((camera.x_m,), (camera.y_m,), (camera.z_m,))))[:, 0] + (pose.x, pose.y, pose.z)
    return OpticalPose(eye, base[:, _OPTICAL_AXES] * _OPTICAL_SIGNS)


def view_matrix(optical: OpticalPose) -> Matrix:
    """Returns the (4, 4) matrix from world to OpenGL eye frame (x right, y up, z backward), for column vectors."""
    view = np.eye(4)
    view[:3, :3] = optical.rotation.T * np.array([[1.0], [-1.0], [-1.0]])
    view[:3, 3] = -product(view[:3, :3], optical.eye[:, None])[:, 0]
    return view


def projection_matrix(camera: CameraConfig) -> Matrix:
    """Returns the (4, 4) OpenGL perspective matrix of a square image; its clip w is the depth in metres."""
    scale = 1.0 / math.tan(math.radians(camera.fov_deg) / 2)
    near, far = camera.near_m, camera.far_m
    matrix = np.zeros((4, 4))
    matrix[0, 0] = matrix[1, 1] = scale
    matrix[2, 2], matrix[2, 3] = (far + near) / (near - far), 2 * far * near / (near - far)
    matrix[3, 2] = -1.0
    return matrix


def intrinsics(camera: CameraConfig, size: int) -> Matrix:
    """Returns the (3, 3) intrinsic matrix, from the optical frame to pixels of a `size` x `size` image.

    The image spans [0, size) in both directions, so that the centre of pixel (row, column) is
    (column + 0.5, row + 0.5).
    """
    focal = size / 2 / math.tan(math.radians(camera.fov_deg) / 2)
    return np.array(((focal, 0.0, size / 2), (0.0, focal, size / 2), (0.0, 0.0, 1.0)))


def _rotation(pose: Pose) -> Matrix:
    w, x, y, z = pose.qw, pose.qx, pose.qy, pose.qz
    return np.array(
        (
            (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        )
    )
