"""Describes a rig for the readers of an export: `rig.json` and the table of the dataset card. Pure functions."""

from __future__ import annotations

from typing import Any

from factory.export.rig.calibration import OPTICAL_QUATERNION, intrinsics_of, mount_row, mounted
from factory.export.source import to_json
from schemas.rig import EquirectangularCamera, FisheyeCamera, Imu, Lidar2d, Lidar3d, PinholeCamera, Rig, Sensor

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
    for sensor, found in zip(rig.sensors, values["sensors"], strict=True):
        found |= _derived(sensor, control_hz)
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
