"""Reads what the sensors of a rig measured in an archived episode, or computes it from the states. Writes nothing."""

from __future__ import annotations

from typing import cast

import numpy as np

from factory.dataset.bundle import EpisodeBundle
from schemas.rig import Camera, Imu, Lidar2d, Lidar3d, Sensor, WheelOdometry
from workers.appearance import changed_sensor
from workers.sensors import ImuMeasurements, LidarScan, OdometryMeasurements
from workers.sensors import observation as sensing
from workers.sensors.observation import CameraMeasurement, Trajectory


def observe(bundle: EpisodeBundle, sensor: Camera | Lidar2d | Lidar3d, t: int) -> CameraMeasurement | LidarScan:
    """Returns the images of a camera, or the scan of a lidar, at step t of an episode.

    They are read if the episode stores them, otherwise rendered; the bytes are equal.

    Raises:
        InvalidBundle: a stored array is damaged.
        ArchiveCorrupt: the scene package is missing or was changed.
        UsageError: a package that the sensor needs is not installed.
        WorldError: this machine cannot render.
    """
    if not is_stored(bundle, sensor) or t % sensor.stride(bundle.control_hz):
        change = None if bundle.appearance is None else bundle.appearance.camera
        return sensing.observe(changed_sensor(sensor, change), t, trajectory_of(bundle), bundle)
    arrays = bundle.measurement(sensor, t)
    return LidarScan(**arrays) if isinstance(sensor, Lidar2d | Lidar3d) else CameraMeasurement(**arrays)


def observe_camera(bundle: EpisodeBundle, camera: Camera, t: int) -> CameraMeasurement:
    """Returns the outputs of a camera at step t of an episode; see `observe`."""
    return cast(CameraMeasurement, observe(bundle, camera, t))


def measure(bundle: EpisodeBundle, sensor: Imu | WheelOdometry) -> ImuMeasurements | OdometryMeasurements:
    """Returns the measurements of an IMU or of wheel odometry over an episode, stored or computed; see `observe`."""
    if not is_stored(bundle, sensor):
        return sensing.measure(sensor, trajectory_of(bundle))
    arrays = bundle.measurement(sensor, None)
    return ImuMeasurements(**arrays) if isinstance(sensor, Imu) else OdometryMeasurements(**arrays)


def is_stored(bundle: EpisodeBundle, sensor: Sensor) -> bool:
    """Returns whether an episode stores measurements of this sensor, with the same name and parameters."""
    rig = bundle.meta.job.view.rig if bundle.has_sensors else None
    return rig is not None and sensor in rig.sensors


def trajectory_of(bundle: EpisodeBundle) -> Trajectory:
    """Returns the recorded states of an episode."""
    job, arrays = bundle.meta.job, bundle.arrays
    twists = arrays.actions_continuous.astype(np.float64)
    return Trajectory(arrays.poses, twists, control_hz=job.task.control_hz, seed=job.root_seed, episode=job.index)
