"""What a policy can see in a running episode: sensors of a rig and the appearance. Runs no episode.

The measurements equal those of `Episode.observe` and `Episode.motion` for the same drive and seed. Instance ids are
omitted, because they are ground truth. Clutter is impossible: it is placed away from a recorded path, and an evaluated
policy drives another path.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from factory.eval.driving.simulator import Simulator
from schemas.appearance import Appearance
from schemas.appearance.appearance_file import find_appearance
from schemas.config import CameraConfig
from schemas.encoding.arrays import ArraySpec
from schemas.errors import UsageError
from schemas.rig import CameraOutput, Imu, PinholeCamera, Rig, Sensor, WheelOdometry
from schemas.rig.arrays import arrays_of
from schemas.rig.requirements import require_sensor_packages
from schemas.rig.rig_file import paper_rig, require_rates
from schemas.support.geometry import planar_states
from workers.sensors.observation import Trajectory, arrays_in, measure, observe

SensorArrays = dict[str, dict[str, NDArray[Any]]]
"""Sensor name -> array name -> array of the latest measurement."""
_IDS = "ids"


def require_live(rig: Rig, control_hz: int) -> None:
    """Raises an error unless a rig can be measured during a drive at a control rate.

    Raises:
        UsageError: A camera has optical flow, which needs the next image, or a package of a sensor is not installed.
        InvalidRig: A rate does not divide the control rate.
    """
    require_rates(rig, control_hz)
    require_sensor_packages(rig)
    for camera in rig.cameras:
        if CameraOutput.FLOW in camera.outputs:
            raise UsageError(
                f"rig {rig.name!r}: camera {camera.name!r} has the output 'flow', which cannot be measured "
                "during a drive, because it needs the next image: remove 'flow' from outputs"
            )


def live_arrays(sensor: Sensor) -> dict[str, ArraySpec]:
    """Returns the specs of the arrays of one measurement of a sensor, by array name; without instance ids."""
    specs = {name: spec for name, spec in arrays_of(sensor).items() if name != _IDS}
    is_motion = isinstance(sensor, Imu | WheelOdometry)
    return {name: replace(spec, shape=spec.shape[1:]) if is_motion else spec for name, spec in specs.items()}


def shows_recorded_camera(rig: Rig | None, camera: CameraConfig) -> bool:
    """Returns whether the recorded camera is available: without a rig, or if a noise-free rig camera equals it."""
    if rig is None:
        return True
    (paper,) = paper_rig().cameras
    return camera == CameraConfig() and any(
        isinstance(each, PinholeCamera) and (each.lens(), each.mount, each.noise) == (paper.lens(), paper.mount, None)
        for each in rig.cameras
    )


def live_state(
    simulator: Simulator, rig: Rig | None = None, sensors: SensorArrays | None = None
) -> NDArray[np.float32]:
    """Returns the state (5,) of the robot at the current step, as `observation.state` of an export has it.

    It is x, y in metres and yaw in radians in the frame of the start, and the measured v in m/s and w in rad/s: those
    of the first wheel odometry of the rig, and without one, those of the simulated poses.

    Args:
        simulator: Running episode.
        rig: Rig of the robot; `None` for the recorded camera.
        sensors: Latest measurements of the rig.
    """
    wheels = [] if rig is None else [sensor.name for sensor in rig.sensors if isinstance(sensor, WheelOdometry)]
    if wheels and sensors is not None:
        measured = sensors[wheels[0]]
        return np.concatenate((measured["poses"], measured["twists"])).astype(np.float32)
    state: NDArray[np.float32] = planar_states(simulator.track, simulator.settings.task.control_hz)[-1]
    return state


class RigSensors:
    """Sensors of a rig in the current episode of a simulator; create another object for the next episode."""

    def __init__(self, rig: Rig, simulator: Simulator) -> None:
        self._rig, self._simulator = rig, simulator
        self._latest: dict[str, tuple[int, dict[str, NDArray[Any]]]] = {}

    def measure(self) -> SensorArrays:
        """Returns copies of the latest measurement of each sensor, which can be older than the current step."""
        # also sensors that do not measure at this step, because Gymnasium needs the same arrays at every step
        track = self._simulator.trajectory()
        for sensor in self._rig.sensors:
            stride = sensor.stride(track.control_hz)
            t = (len(track.poses) - 1) // stride * stride
            if self._latest.get(sensor.name, (-1, {}))[0] != t:
                self._latest[sensor.name] = t, self._measured(sensor, t, track)
        return {
            name: {key: array.copy() for key, array in arrays.items()} for name, (_, arrays) in self._latest.items()
        }

    def _measured(self, sensor: Sensor, t: int, track: Trajectory) -> dict[str, NDArray[Any]]:
        if isinstance(sensor, Imu | WheelOdometry):
            row = t // sensor.stride(track.control_hz)
            return {name: array[row] for name, array in arrays_in(measure(sensor, track)).items()}
        measurement = observe(sensor, t, track, self._simulator.surroundings)
        return {name: array for name, array in arrays_in(measurement).items() if name != _IDS}


def live_appearance(appearance: str | Path | Appearance) -> Appearance | None:
    """Returns the appearance of an evaluation, given as ranges, name or file; `None` for the name `none`.

    Raises:
        UsageError: the appearance does not exist, or has clutter.
        InvalidAppearance: the file is not valid.
    """
    chosen = appearance if isinstance(appearance, Appearance) else find_appearance(str(appearance))
    if chosen is not None and chosen.clutter is not None:
        raise UsageError(
            f"appearance {chosen.name!r} has clutter, which is placed away from a recorded path and has no "
            "collision shape: remove `clutter` for an evaluation, or choose `varied`"
        )
    return chosen
