"""Observes an episode with the sensors of a rig: renders images and casts rays from recorded poses. Reads no file."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from factory.dataset.bundle import EpisodeBundle
from schemas.rig import Camera, CameraOutput, DepthKind, Imu, Lidar2d, Lidar3d, Sensor, WheelOdometry
from workers.geometry.camera import mounted_pose
from workers.geometry.lens import axial_share, optical_flow
from workers.geometry.pose import Pose
from workers.render import CameraImage
from workers.sensors import (
    ImuMeasurements,
    LidarScan,
    NoiseKey,
    OdometryMeasurements,
    colour_steps,
    sense_colour,
    sense_depth,
    sense_imu,
    sense_lidar,
    sense_odometry,
)
from workers.sensors.frames import poses_at


class CameraObservation(NamedTuple):
    """Images of one camera at one step; `None` for an image that is not an output of the camera."""

    rgb: NDArray[np.uint8] | None = None
    """(height, width, 3) sRGB, top row first."""
    depth: NDArray[np.float32] | None = None
    """(height, width) metres, axial or radial as the camera has it; 0 where no surface was hit."""
    ids: NDArray[np.uint16] | None = None
    """(height, width) instance ids, described by `Episode.instances`; 0 is background."""
    normals: NDArray[np.float32] | None = None
    """(height, width, 3) unit normals in the optical frame (x right, y down, z forward); 0 where no surface was hit."""
    flow: NDArray[np.float32] | None = None
    """(height, width, 2) displacement to the right and down until the camera's next image, pixels; NaN where it is not
    defined. `None` if the episode ends before that image."""


def observe(bundle: EpisodeBundle, sensor: Camera | Lidar2d | Lidar3d, t: int) -> CameraObservation | LidarScan:
    """Returns the images of a camera, or the scan of a lidar, at step t of an episode, with the noise of the sensor.

    Raises:
        ArchiveCorrupt: the scene package is missing or was changed.
        UsageError: a package that the sensor needs is not installed.
        WorldError: this machine cannot render.
    """
    if isinstance(sensor, Lidar2d | Lidar3d):
        hz = bundle.meta.job.task.control_hz
        return sense_lidar(bundle.package.rays(), sensor, bundle.arrays.poses, t, hz, _key(bundle, sensor))
    return observe_camera(bundle, sensor, t)


def observe_camera(bundle: EpisodeBundle, camera: Camera, t: int) -> CameraObservation:
    """Returns the outputs of a camera at step t of an episode; raises the errors of `observe`."""
    image = bundle.render_camera(Pose.of(bundle.arrays.poses[t]), camera)
    key, wanted = _key(bundle, camera), camera.outputs
    return CameraObservation(
        _colour(bundle, camera, t, image.rgb) if CameraOutput.RGB in wanted else None,
        sense_depth(camera, image.depth, key, t) if CameraOutput.DEPTH in wanted else None,
        image.ids if CameraOutput.IDS in wanted else None,
        image.normals,
        _flow(bundle, camera, t, image) if CameraOutput.FLOW in wanted else None,
    )


def measure(bundle: EpisodeBundle, sensor: Imu | WheelOdometry) -> ImuMeasurements | OdometryMeasurements:
    """Returns the measurements of an IMU or of wheel odometry over an episode, with the noise of the sensor."""
    arrays, hz, key = bundle.arrays, bundle.meta.job.task.control_hz, _key(bundle, sensor)
    if isinstance(sensor, Imu):
        return sense_imu(sensor, arrays.poses, hz, key)
    return sense_odometry(sensor, arrays.actions_continuous.astype(np.float64), hz, key)


def _key(bundle: EpisodeBundle, sensor: Sensor) -> NoiseKey:
    return NoiseKey(bundle.meta.job.root_seed, bundle.meta.job.index, sensor.name)


def _colour(bundle: EpisodeBundle, camera: Camera, t: int, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Returns the recorded colour; motion blur and a rolling shutter need images at several times."""
    times = colour_steps(camera, t, bundle.meta.job.task.control_hz)
    between = [Pose.of(row) for row in poses_at(bundle.arrays.poses, times)] if len(times) > 1 else []
    images = [bundle.render_camera(pose, camera).rgb for pose in between] or [rgb]
    return sense_colour(camera, np.stack(images), _key(bundle, camera), t)


def _flow(bundle: EpisodeBundle, camera: Camera, t: int, image: CameraImage) -> NDArray[np.float32] | None:
    poses, later = bundle.arrays.poses, t + camera.stride(bundle.meta.job.task.control_hz)
    if later >= len(poses):
        return None
    distance = image.depth.astype(np.float64)
    if camera.depth is DepthKind.AXIAL:
        distance /= axial_share(camera)
    eyes = [mounted_pose(Pose.of(poses[step]), camera.mount) for step in (t, later)]
    return optical_flow(camera, distance, *eyes).astype(np.float32)
