"""Reads the measurements of an episode's rig for exporters.

Provides all measurements of IMUs and odometry; for cameras and lidars, provides the latest measurement at or before a
step. Every sensor measures at step 0, so a latest measurement always exists. Encodes nothing.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from factory.dataset.episode import Episode
from factory.export.rig.description import recorded_rig
from schemas.rig import Camera, Lidar2d, Lidar3d, PinholeCamera, Rig
from workers.appearance.cameras import changed_camera
from workers.sensors import CameraMeasurement, ImuMeasurements, LidarScan, OdometryMeasurements

Array = NDArray[Any]
Seen = CameraMeasurement | LidarScan
Motion = ImuMeasurements | OdometryMeasurements


def shown_rig(episode: Episode) -> Rig:
    """Returns the rig of the exported images, or the recorded camera as a rig, as the appearance has changed them.

    The appearance of an episode may shift, turn and zoom its cameras (docs/appearance.md), so these cameras and not
    those of the plan have the intrinsics and poses of the images.
    """
    rig = episode.rig or recorded_rig(episode.meta.job.camera)
    change = None if episode.appearance is None else episode.appearance.camera
    changed = tuple(changed_camera(one, change) if isinstance(one, Camera) else one for one in rig.sensors)
    return rig.model_copy(update={"sensors": changed})


def shown_pinhole(episode: Episode) -> PinholeCamera:
    """Returns the recorded camera of an episode that is exported without a rig, as the appearance has changed it."""
    (camera,) = shown_rig(episode).cameras
    assert isinstance(camera, PinholeCamera), "the recorded camera is a pinhole camera"
    return camera


class _Kept(NamedTuple):
    step: int
    measurement: Seen


class SensorReader:
    """Measurements of the rig of an episode. If they are read in the order of the steps, each is computed only once.

    Raises:
        UsageError: the episode has no rig.
    """

    def __init__(self, episode: Episode) -> None:
        self.motion: dict[str, Motion] = episode.motion()
        """Measurements of IMUs and odometry over the whole episode, by name of the sensor."""
        assert episode.rig is not None, "`Episode.motion` returned for an episode without a rig"
        self.rig: Rig = episode.rig
        self.hz: int = episode.meta.job.task.control_hz
        """Control rate, steps per second."""
        self.strides = {sensor.name: sensor.stride(self.hz) for sensor in self.rig.sensors}
        """Number of control steps between two measurements, by name of the sensor."""
        self.shown: dict[str, Camera] = {camera.name: camera for camera in shown_rig(episode).cameras}
        """Cameras as the appearance of the episode has changed them, by name."""
        self._episode = episode
        self._kept: dict[str, _Kept] = {}

    def latest_step(self, name: str, t: int) -> int:
        """Returns the step of the latest measurement of a sensor at or before step t."""
        return t - t % self.strides[name]

    def latest(self, name: str, t: int) -> Seen:
        """Returns the latest measurement of a camera or lidar at or before step t."""
        # not interpolated: images cannot be, and an interpolated value would depend on the future
        step = self.latest_step(name, t)
        kept = self._kept.get(name)
        if kept is None or kept.step != step:
            kept = self._kept[name] = _Kept(step, self._episode.observe(step, [name])[name])
        return kept.measurement

    def scan(self, lidar: Lidar2d | Lidar3d, t: int) -> LidarScan:
        """Returns the latest scan of a lidar at or before step t."""
        latest = self.latest(lidar.name, t)
        assert isinstance(latest, LidarScan)
        return latest

    def arrays(self, sensor: Camera | Lidar2d | Lidar3d, t: int) -> dict[str, Array]:
        """Returns the latest outputs of a camera, or `ranges` and `ids` of a lidar, at or before step t.

        The flow of the last image is NaN, because no image follows.
        """
        arrays = self.latest(sensor.name, t)
        if isinstance(arrays, LidarScan):
            return {"ranges": arrays.ranges, "ids": arrays.ids}
        assert isinstance(sensor, Camera)
        blank = np.full((sensor.height, sensor.width, 2), np.nan, np.float32)
        return {output: blank if (image := getattr(arrays, output)) is None else image for output in sensor.outputs}


def arrays_of(motion: Motion) -> dict[str, Array]:
    """Returns the arrays that an IMU or odometry measured in an episode, by name; one row for each measurement."""
    if isinstance(motion, ImuMeasurements):
        return {"angular_velocity": motion.angular_velocity, "specific_force": motion.specific_force}
    return {"ticks": motion.ticks, "poses": motion.poses, "twists": motion.twists}
