"""Geometry of perspective images: optical pose, view matrix, projection matrix and intrinsics.

Pure functions in float64. Does not render and uses no graphics library.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from schemas.config import CameraConfig
from schemas.rig.sensors import Mount
from schemas.support.portable import product
from workers.geometry.pose import Pose

Matrix = NDArray[np.float64]


_OPTICAL_AXES, _OPTICAL_SIGNS = [1, 2, 0], np.array((-1.0, -1.0, 1.0))
"""Columns of a rotation of base_link (forward, left, up), and the signs that turn them into the optical axes right,
down and forward."""


@dataclass(frozen=True, slots=True)
class OpticalPose:
    """Pose of the optical frame (x right, y down, z forward) in the world frame."""

    eye: Matrix
    """(3,) projection centre, metres."""
    rotation: Matrix
    """(3, 3) rotation matrix; its columns are the optical axes x, y, z as unit vectors in the world frame."""


def optical_pose(pose: Pose, camera: CameraConfig) -> OpticalPose:
    """Returns the pose of the optical frame for a pose of base_link; the optical axis is parallel to base_link's x."""
    return mounted_pose(pose, Mount(x_m=camera.x_m, y_m=camera.y_m, z_m=camera.z_m))


def mounted_pose(pose: Pose, mount: Mount) -> OpticalPose:
    """Returns the pose of a sensor's optical frame for a pose of base_link; its optical axis is the sensor's x axis."""
    base = _rotation(pose)
    eye = product(base, np.array(((mount.x_m,), (mount.y_m,), (mount.z_m,))))[:, 0] + (pose.x, pose.y, pose.z)
    axes = product(base, mount_rotation(mount)) if _is_turned(mount) else base
    return OpticalPose(eye, axes[:, _OPTICAL_AXES] * _OPTICAL_SIGNS)


def mount_rotation(mount: Mount) -> Matrix:
    """Returns the (3, 3) rotation from the sensor frame to base_link."""
    (cr, cp, cy), (sr, sp, sy) = (
        [function(math.radians(angle)) for angle in (mount.roll_deg, mount.pitch_deg, mount.yaw_deg)]
        for function in (math.cos, math.sin)
    )
    return np.array(
        (
            (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
            (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
            (-sp, cp * sr, cp * cr),
        )
    )


def _is_turned(mount: Mount) -> bool:
    return any((mount.roll_deg, mount.pitch_deg, mount.yaw_deg))


def view_matrix(optical: OpticalPose) -> Matrix:
    """Returns the (4, 4) matrix from world to OpenGL eye frame (x right, y up, z backward), for column vectors."""
    view = np.eye(4)
    view[:3, :3] = optical.rotation.T * np.array([[1.0], [-1.0], [-1.0]])
    view[:3, 3] = -product(view[:3, :3], optical.eye[:, None])[:, 0]
    return view


class Perspective(NamedTuple):
    """Perspective image without distortion, of any size and with any principal point."""

    width: int
    """Width, pixels."""
    height: int
    """Height, pixels."""
    half: tuple[float, float]
    """Half width and half height on the plane z = 1 of the optical frame."""
    centre: tuple[float, float]
    """Column and row of the principal point, pixels from the left and the top edge."""
    near_m: float
    """Start of the clip range along the optical axis, metres."""
    far_m: float
    """End of the clip range, metres."""

    @classmethod
    def of(cls, camera: CameraConfig, size: int) -> Self:
        """Returns the image of `size` x `size` pixels of a camera."""
        half = math.tan(math.radians(camera.fov_deg) / 2)
        return cls(size, size, (half, half), (size / 2, size / 2), camera.near_m, camera.far_m)

    @property
    def focal_px(self) -> tuple[float, float]:
        """Focal lengths along rows and columns, pixels."""
        return self.width / 2 / self.half[0], self.height / 2 / self.half[1]

    @property
    def corner(self) -> float:
        """Distance from the eye to the farthest point of the image on the plane z = 1."""
        reach = [
            max(centre, side - centre) / focal
            for centre, side, focal in zip(self.centre, (self.width, self.height), self.focal_px, strict=True)
        ]
        return math.sqrt(1 + reach[0] ** 2 + reach[1] ** 2)

    def matrix(self) -> Matrix:
        """Returns the (4, 4) OpenGL projection matrix; its clip w is the depth in metres."""
        near, far = self.near_m, self.far_m
        matrix = np.zeros((4, 4))
        matrix[0, 0], matrix[1, 1] = 1.0 / self.half[0], 1.0 / self.half[1]
        matrix[0, 2], matrix[1, 2] = 1 - 2 * self.centre[0] / self.width, 2 * self.centre[1] / self.height - 1
        matrix[2, 2], matrix[2, 3] = (far + near) / (near - far), 2 * far * near / (near - far)
        matrix[3, 2] = -1.0
        return matrix

    def steps(self) -> tuple[Matrix, Matrix]:
        """Returns x (width,) of the columns and y (height,) of the rows on the plane z = 1, at pixel centres."""
        fx, fy = self.focal_px
        columns, rows = np.arange(self.width, dtype=np.float64), np.arange(self.height, dtype=np.float64)
        return (columns + 0.5 - self.centre[0]) / fx, (rows + 0.5 - self.centre[1]) / fy


def projection_matrix(camera: CameraConfig) -> Matrix:
    """Returns the (4, 4) OpenGL perspective matrix of a square image; its clip w is the depth in metres."""
    return Perspective.of(camera, 1).matrix()


def intrinsics(camera: CameraConfig, size: int) -> Matrix:
    """Returns the (3, 3) intrinsic matrix, from the optical frame to pixels of a `size` x `size` image.

    The image spans [0, size) in both directions, so the centre of pixel (row, column) is
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
