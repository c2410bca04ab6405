"""Calibration of the sensors of a rig for other programs: camera matrices of OpenCV and mounting quaternions.

Pure functions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from schemas.rig import Camera, EquirectangularCamera, FisheyeCamera, Mount, Sensor, WheelOdometry
from schemas.rig.mount import MountedSensor
from schemas.support.numpy_types import Floats
from workers.geometry.camera import mount_rotation

OPTICAL_QUATERNION = (0.5, -0.5, 0.5, -0.5)
"""Quaternion (w, x, y, z) of the optical frame (z forward, x right, y down) in the frame of its camera."""


class Intrinsics(NamedTuple):
    """Camera matrix and distortion with the conventions of OpenCV and ROS: the first pixel has its centre at (0, 0)."""

    matrix: tuple[float, ...]
    """(9,) camera matrix, row by row."""
    is_fisheye: bool
    """Whether `distortion` belongs to the model of `cv2.fisheye`; otherwise, it belongs to Brown-Conrady."""
    distortion: tuple[float, ...]
    """Coefficients: k1 to k4 for `cv2.fisheye`; otherwise k1, k2, p1, p2, k3."""

    @property
    def projection(self) -> tuple[float, ...]:
        """(12,) projection matrix, row by row, of a camera that is not part of a rectified pair."""
        fx, _, cx, _, fy, cy, *_ = self.matrix
        return (fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0)


def intrinsics_of(camera: Camera) -> Intrinsics | None:
    """Returns the intrinsics of a pinhole or fisheye camera; `None` for a panorama, which has none."""
    if isinstance(camera, EquirectangularCamera):
        return None
    (fx, fy), (cx, cy) = camera.focal_px, camera.centre_px
    matrix = (fx, 0.0, cx - 0.5, 0.0, fy, cy - 0.5, 0.0, 0.0, 1.0)
    return Intrinsics(matrix, isinstance(camera, FisheyeCamera), camera.distortion)


def mount_row(mount: Mount) -> tuple[float, ...]:
    """Returns x, y, z, qw, qx, qy, qz of a sensor frame (x forward, y left, z up) in base_link."""
    return (mount.x_m, mount.y_m, mount.z_m, *quaternion_of(mount_rotation(mount)))


def mounted(sensor: Sensor) -> MountedSensor | None:
    """Returns the sensor if it has a mounting pose; `None` for wheel odometry, which has none."""
    return None if isinstance(sensor, WheelOdometry) else sensor


def quaternion_of(rotation: Floats) -> tuple[float, float, float, float]:
    """Returns the quaternion w, x, y, z, with w at least 0, of a rotation matrix (3, 3).

    The largest component is computed from the diagonal, so nothing is divided by a small number (S. W. Shepperd,
    "Quaternion from rotation matrix", Journal of Guidance and Control 1(3), 1978).
    """
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    rows = (
        (1 + a + e + i, h - f, c - g, d - b),
        (h - f, 1 + a - e - i, b + d, c + g),
        (c - g, b + d, 1 - a + e - i, f + h),
        (d - b, c + g, f + h, 1 - a - e + i),
    )
    largest = max(range(4), key=lambda k: rows[k][k])
    row = np.array(rows[largest])
    unit = row / np.sqrt((row * row).sum())
    w, x, y, z = (unit if unit[0] >= 0 else -unit).tolist()
    return w + 0.0, x + 0.0, y + 0.0, z + 0.0
