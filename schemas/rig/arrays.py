"""Arrays that the sensors of a rig give, with shape, type, unit and bounds, and the steps at which they are measured.

Recorder, validator, reader and the Gymnasium environment share these specs. Measures nothing.
"""

from __future__ import annotations

import numpy as np

from schemas.encoding.arrays import ArraySpec
from schemas.rig.cameras import Camera, CameraOutput, DepthKind
from schemas.rig.rig import Rig, Sensor
from schemas.rig.sensors import Imu, Lidar2d, Lidar3d, WheelOdometry

MAX_MEASURED_IMAGES = 60_000
"""Largest number of stored images and scans of an episode; a bundle has at most 65,535 members, frames included."""
_MOST_RADIAL = 3.0
"""Upper bound of the radial depth of a camera, as a multiple of `far_m`. A camera is rendered to a single image plane,
which reaches at most 63 degrees from the optical axis along rows and columns, or to the sides of a cube, which reach
45 degrees."""


def is_of_motion(sensor: Sensor) -> bool:
    """Returns whether a sensor measures the motion of the robot, over the whole episode; others measure the scene."""
    return isinstance(sensor, Imu | WheelOdometry)


def arrays_of(sensor: Sensor) -> dict[str, ArraySpec]:
    """Returns the specs of a sensor's arrays by name, in the order of a bundle.

    A camera or lidar has these arrays for each measurement; those of a sensor of motion have one row for each
    measurement of the episode.
    """
    specs = _specs(sensor)
    return {spec.name.partition("/")[2]: spec for spec in specs}


def measured_steps(sensor: Sensor, length: int, control_hz: int) -> range:
    """Returns the steps at which a sensor measures in an episode of `length` steps."""
    return range(0, length, sensor.stride(control_hz))


def arrays_at(sensor: Sensor, t: int, length: int, control_hz: int) -> dict[str, ArraySpec]:
    """Returns the specs of the arrays that a camera or lidar gives at step t; the last image has no optical flow."""
    is_last = t + sensor.stride(control_hz) >= length
    specs = arrays_of(sensor)
    return {name: spec for name, spec in specs.items() if not (is_last and name == CameraOutput.FLOW)}


def rig_faults(rig: Rig, control_hz: int, max_steps: int) -> list[str]:
    """Returns what prevents storing a rig: rates that do not fit the control rate, or too many measurements."""
    faults = rig.faults(control_hz)
    if faults:
        return faults
    seen = [sensor for sensor in rig.sensors if not is_of_motion(sensor)]
    images = sum(len(arrays_of(sensor)) * len(measured_steps(sensor, max_steps, control_hz)) for sensor in seen)
    if images <= MAX_MEASURED_IMAGES:
        return []
    return [
        f"rig {rig.name!r} gives {images} images and scans in an episode of {max_steps} steps, at most "
        f"{MAX_MEASURED_IMAGES} can be stored: reduce sensors, outputs, rate_hz or task.max_steps"
    ]


def _specs(sensor: Sensor) -> list[ArraySpec]:
    match sensor:
        case Imu():
            gyro, force = sensor.gyro_range_rps, sensor.accelerometer_range_mps2
            return [
                ArraySpec(
                    f"{sensor.name}/angular_velocity", (None, 3), dtype=np.float32, unit="rad/s", low=-gyro, high=gyro
                ),
                ArraySpec(
                    f"{sensor.name}/specific_force", (None, 3), dtype=np.float32, unit="m/s2", low=-force, high=force
                ),
            ]
        case WheelOdometry():
            return [
                ArraySpec(f"{sensor.name}/ticks", (None, 2), np.int64, "ticks"),
                ArraySpec(f"{sensor.name}/poses", (None, 3), np.float64, "(m, m, rad)"),
                ArraySpec(f"{sensor.name}/twists", (None, 2), np.float64, "(m/s, rad/s)"),
            ]
        case Lidar2d() | Lidar3d():
            shape = (len(sensor.elevations_deg) if isinstance(sensor, Lidar3d) else 1, sensor.samples)
            return [
                ArraySpec(f"{sensor.name}/ranges", shape, dtype=np.float32, unit="m", low=0.0, high=sensor.range_max_m),
                ArraySpec(f"{sensor.name}/ids", shape, np.uint16, "instance id"),
                ArraySpec(f"{sensor.name}/cosines", shape, dtype=np.float32, unit="1", low=0.0, high=1.0 + 1e-6),
            ]
    return [_image_spec(sensor, output) for output in CameraOutput if output in sensor.outputs]


def _image_spec(camera: Camera, output: CameraOutput) -> ArraySpec:
    name, shape = f"{camera.name}/{output}", (camera.height, camera.width)
    match output:
        case CameraOutput.RGB:
            return ArraySpec(name, (*shape, 3), np.uint8, "sRGB")
        case CameraOutput.DEPTH:
            return ArraySpec(name, shape, dtype=np.float32, unit="m", low=0.0, high=_most_depth_m(camera))
        case CameraOutput.IDS:
            return ArraySpec(name, shape, np.uint16, "instance id")
        case CameraOutput.NORMALS:
            return ArraySpec(name, (*shape, 3), dtype=np.float32, unit="1", low=-1.0 - 1e-6, high=1.0 + 1e-6)
        case CameraOutput.FLOW:
            return ArraySpec(name, (*shape, 2), np.float32, "px", may_be_nan=True)


def _most_depth_m(camera: Camera) -> float | None:
    """Returns the largest depth of a camera, metres; `None` for a camera with noisy depth, which has no limit."""
    if camera.noise is not None and camera.noise.depth is not None:
        return None
    return camera.far_m * (1.0 if camera.depth is DepthKind.AXIAL else _MOST_RADIAL) + 1e-3
