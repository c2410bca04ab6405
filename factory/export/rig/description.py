"""Describes the cameras of an export for its readers: `rig.json`, the table of the card, matrices and poses of cameras.

The recorded camera is described as a rig with this camera only. Pure functions.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy  # imports `scipy.spatial` at its first use

from factory.export.source import to_json
from schemas.config import CameraConfig
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.rig import (
    Camera,
    EquirectangularCamera,
    FisheyeCamera,
    Imu,
    Lidar2d,
    Lidar3d,
    Mount,
    PinholeCamera,
    Rig,
    Sensor,
    WheelOdometry,
)
from schemas.rig.sensors import MountedSensor
from schemas.support.numpy_types import Floats
from workers.appearance.cameras import recorded_camera
from workers.geometry.camera import mount_rotation

OPTICAL_QUATERNION = (0.5, -0.5, 0.5, -0.5)
"""Quaternion (w, x, y, z) of the optical frame (z forward, x right, y down) in the frame of its camera."""


FRONT = "front"
"""Name of the recorded camera in exports."""


def recorded_rig(camera: CameraConfig) -> Rig:
    """Returns the recorded camera as a rig with this camera only; its images have 640 x 640 pixels."""
    return Rig(name="recorded", sensors=(recorded_camera(camera, FRAME_SIZE_PX).model_copy(update={"name": FRONT}),))


def optical_poses(poses: Floats, mount: Mount) -> Floats:
    """Returns the (T, 7) poses of a camera's optical frame (x right, y down, z forward) in the world.

    Args:
        poses: (T, 7) poses of base_link in the world: x, y, z metres, and a quaternion w, x, y, z.
        mount: pose of the camera frame in base_link.

    Returns:
        x, y, z in metres, and a quaternion w, x, y, z with w at least 0.
    """
    Rotation = scipy.spatial.transform.Rotation  # noqa: N806 - a class
    base = Rotation.from_quat(poses[:, [4, 5, 6, 3]])
    w, x, y, z = OPTICAL_QUATERNION
    turns = base * Rotation.from_matrix(mount_rotation(mount)) * Rotation.from_quat((x, y, z, w))
    eyes = poses[:, :3] + base.apply((mount.x_m, mount.y_m, mount.z_m))
    return np.concatenate((eyes, turns.as_quat(canonical=True)[:, [3, 0, 1, 2]]), axis=1)


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


RIG_FILE = "rig.json"
_CAMERA = PinholeCamera | FisheyeCamera | EquirectangularCamera
_TABLE = """
Sensors of rig `{name}`; `{file}` has their mounting poses, intrinsics and noise.

| sensor | model | measurements a second | size |
|---|---|---|---|
"""


def rig_json(rig: Rig, control_hz: int) -> str:
    """Returns the text of `rig.json`: the rig, and for each sensor its pose and calibration.

    `every_steps` is the number of control steps between two measurements; `pose` is x, y, z, qw, qx, qy, qz of the
    sensor frame in base_link; `camera_matrix` and `distortion` are those of OpenCV.
    """
    values = rig.model_dump(mode="json")
    values["control_hz"] = control_hz
    values["optical_quaternion_wxyz"] = OPTICAL_QUATERNION
    for sensor, values_of_sensor in zip(rig.sensors, values["sensors"], strict=True):
        values_of_sensor |= _derived(sensor, control_hz)
    return to_json(values) + "\n"


def _derived(sensor: Sensor, control_hz: int) -> dict[str, Any]:
    values: dict[str, Any] = {"every_steps": sensor.stride(control_hz)}
    if (frame := mounted(sensor)) is not None:
        values["pose"] = mount_row(frame.mount)
    if isinstance(sensor, _CAMERA) and (intrinsics := intrinsics_of(sensor)) is not None:
        values["camera_matrix"] = intrinsics.matrix
        values["distortion_model"] = "cv2.fisheye" if intrinsics.is_fisheye else "brown_conrady"
        values["distortion"] = intrinsics.distortion
    return values


def rig_table(rig: Rig, control_hz: int, file: str = RIG_FILE) -> str:
    """Returns a Markdown table of the sensors for the card; `file` is the path of `rig.json` in the export."""
    rows = [
        f"| `{one.name}` | {one.model} | {control_hz / one.stride(control_hz):g} | {_size(one)} |"
        for one in rig.sensors
    ]
    return _TABLE.format(name=rig.name, file=file) + "\n".join(rows) + "\n"


def _size(sensor: Sensor) -> str:
    match sensor:
        case Lidar3d():
            return f"{len(sensor.elevations_deg)} lines of {sensor.samples} rays"
        case Lidar2d():
            return f"{sensor.samples} rays"
        case PinholeCamera() | FisheyeCamera() | EquirectangularCamera():
            return f"{sensor.width} x {sensor.height} px, {', '.join(sensor.outputs)}"
        case Imu():
            return "angular velocity, specific force"
    return "ticks, pose, twist"
