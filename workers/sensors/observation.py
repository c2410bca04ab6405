"""Measurements of the sensors of a rig along a trajectory: images, scans and motion, with the noise of each sensor.

Recorder, reader, evaluation and the Gymnasium environment share these functions. The caller renders and casts rays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from schemas.rig import Camera, CameraOutput, DepthKind, Imu, Lidar2d, Lidar3d, Sensor, WheelOdometry
from schemas.support.numpy_types import Floats
from workers.geometry.camera import mounted_pose
from workers.geometry.lens import axial_share, optical_flow
from workers.geometry.pose import Pose
from workers.render import CameraImage
from workers.sensors.frames import poses_at
from workers.sensors.images import colour_steps, sense_colour, sense_depth
from workers.sensors.imu import ImuMeasurements, sense_imu
from workers.sensors.lidar import LidarScan, RayCaster, sense_lidar
from workers.sensors.odometry import OdometryMeasurements, sense_odometry
from workers.sensors.streams import NoiseKey


class CameraMeasurement(NamedTuple):
    """Images of one camera at one step; `None` for an image that is not an output of the camera."""

    rgb: NDArray[np.uint8] | None = None
    """(height, width, 3) sRGB, top row first."""
    depth: NDArray[np.float32] | None = None
    """(height, width) metres, axial or radial as the camera defines; 0 where no surface was hit."""
    ids: NDArray[np.uint16] | None = None
    """(height, width) instance ids, described by `Episode.instances`; 0 is background."""
    normals: NDArray[np.float32] | None = None
    """(height, width, 3) unit normals in the optical frame (x right, y down, z forward); 0 where no surface was hit."""
    flow: NDArray[np.float32] | None = None
    """(height, width, 2) displacement to the right and down until the camera's next image, pixels; NaN where it is not
    defined. `None` if the episode ends before that image."""


Measurement = CameraMeasurement | LidarScan | ImuMeasurements | OdometryMeasurements
"""Measurement of any sensor."""


class Surroundings(Protocol):
    """Scene of an episode, as cameras and lidars measure it."""

    def render_camera(self, pose: Pose, camera: Camera) -> CameraImage:
        """Returns the image of a camera, without noise, for a pose of base_link."""

    def rays(self) -> RayCaster:
        """Returns the ray caster of the scene."""


@dataclass(frozen=True)
class Trajectory:
    """Exact states of an episode, or of its steps so far, and the seed of its noise."""

    poses: Floats
    """(T, 7) poses of base_link in the world: x, y, z in metres, qw, qx, qy, qz."""
    twists: Floats
    """(T, 2) commanded twists, m/s and rad/s; the last one is not used."""
    control_hz: int
    """Control rate, steps per second."""
    seed: int
    """Root seed of the noise."""
    episode: int
    """Number of the episode, for the noise."""

    def key(self, sensor: Sensor) -> NoiseKey:
        """Returns the identity of a sensor in the episode, which determines its noise."""
        return NoiseKey(self.seed, self.episode, sensor.name)


def observe(
    sensor: Camera | Lidar2d | Lidar3d, t: int, track: Trajectory, scene: Surroundings
) -> CameraMeasurement | LidarScan:
    """Returns the images of a camera, or the scan of a lidar, at step t of a trajectory, with the noise of the sensor.

    Raises:
        ArchiveCorrupt: the scene package is missing or was changed.
        UsageError: a package that the sensor needs is not installed.
        WorldError: this machine cannot render.
    """
    if isinstance(sensor, Lidar2d | Lidar3d):
        return sense_lidar(
            scene.rays(), sensor, poses=track.poses, step=t, control_hz=track.control_hz, key=track.key(sensor)
        )
    return observe_camera(sensor, t, track, scene)


def observe_camera(camera: Camera, t: int, track: Trajectory, scene: Surroundings) -> CameraMeasurement:
    """Returns the outputs of a camera at step t of a trajectory; raises the errors of `observe`."""
    image = scene.render_camera(Pose.of(track.poses[t]), camera)
    key, wanted = track.key(camera), camera.outputs
    return CameraMeasurement(
        _colour(camera, t, track, scene, image.rgb) if CameraOutput.RGB in wanted else None,
        sense_depth(camera, image.depth, key, t) if CameraOutput.DEPTH in wanted else None,
        ids=image.ids if CameraOutput.IDS in wanted else None,
        normals=image.normals,
        flow=_flow(camera, t, track, image) if CameraOutput.FLOW in wanted else None,
    )


def measure(sensor: Imu | WheelOdometry, track: Trajectory) -> ImuMeasurements | OdometryMeasurements:
    """Returns the measurements of an IMU or of wheel odometry over a trajectory, with the noise of the sensor."""
    if isinstance(sensor, Imu):
        return sense_imu(sensor, track.poses, track.control_hz, track.key(sensor))
    return sense_odometry(sensor, track.twists, track.control_hz, track.key(sensor))


def arrays_in(measurement: Measurement) -> dict[str, NDArray[Any]]:
    """Returns the arrays of a measurement by the names of `schemas.rig.arrays.arrays_of`."""
    values = measurement._asdict() if isinstance(measurement, CameraMeasurement) else vars(measurement)
    return {name: array for name, array in values.items() if array is not None}


def _colour(
    camera: Camera, t: int, track: Trajectory, scene: Surroundings, rgb: NDArray[np.uint8]
) -> NDArray[np.uint8]:
    """Returns the measured colour; renders more images if motion blur or a rolling shutter needs several poses."""
    times = colour_steps(camera, t, track.control_hz)
    between = [Pose.of(row) for row in poses_at(track.poses, times)] if len(times) > 1 else []
    images = [scene.render_camera(pose, camera).rgb for pose in between] or [rgb]
    return sense_colour(camera, np.stack(images), track.key(camera), t)


def _flow(camera: Camera, t: int, track: Trajectory, image: CameraImage) -> NDArray[np.float32] | None:
    later = t + camera.stride(track.control_hz)
    if later >= len(track.poses):
        return None
    distance = image.depth.astype(np.float64)
    if camera.depth is DepthKind.AXIAL:
        distance /= axial_share(camera)
    eyes = [mounted_pose(Pose.of(track.poses[step]), camera.mount) for step in (t, later)]
    return optical_flow(camera, distance, *eyes).astype(np.float32)
