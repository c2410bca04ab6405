"""Renders frames and rig measurements of a driven trajectory into the bundle of an episode.

Does not simulate the drive. A frame is a function of scene, camera and pose, and a measurement of scene, sensor,
trajectory and seed, so both may be computed at any time after their step.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from schemas.appearance import CameraChange
from schemas.bundle import MAX_BUNDLE_BYTES, BundleWriter, EpisodeArrays
from schemas.errors import WorldError
from schemas.job import Job, episode_id
from schemas.measure import shows_nothing, target_in_view
from schemas.rig import Camera, Imu, Rig, Sensor, WheelOdometry
from schemas.rig.arrays import arrays_of, is_of_motion, measured_steps
from schemas.rig.measurements import encode_array, measurements_of
from workers.appearance import changed_sensor
from workers.geometry.pose import Pose
from workers.render import CameraImage, Renderer
from workers.sensors.lidar import RayCaster
from workers.sensors.observation import Measurement, Surroundings, Trajectory, arrays_in, measure, observe
from workers.sim.context import LoadedScene


def add_frames(
    writer: BundleWriter,
    renderer: Renderer,
    job: Job,
    poses: NDArray[np.float64],
    instance_id: int,
    on_frame: Callable[[int], None],
) -> int:
    """Renders and stores the frames of all poses; returns the number of frames that show the target.

    Args:
        writer: bundle without frames.
        renderer: renderer with the scene loaded.
        job: job, with the smallest mask of a visible target.
        poses: (T, 7) poses of base_link: x, y, z, qw, qx, qy, qz.
        instance_id: id of the target.
        on_frame: called after each frame with the number of frames.
    """
    visible = 0
    for t, row in enumerate(poses, 1):
        frame = renderer.render(Pose.of(row))
        visible += target_in_view(frame.ids, instance_id, job.gains.min_mask_px)
        writer.add_frame(frame.rgb, frame.depth, frame.ids)
        on_frame(t)
    return visible


def add_sampled_digests(writer: BundleWriter, renderer: Renderer, job: Job, poses: NDArray[np.float64]) -> bool:
    """Renders the sampled frames of a states recording and adds their digests; returns whether the first is blank.

    Args:
        writer: bundle without frames.
        renderer: renderer with the scene loaded.
        job: job, with the sampled steps.
        poses: (T, 7) poses of base_link: x, y, z, qw, qx, qy, qz.
    """
    is_blank = False
    for t in job.sampled_steps(len(poses)):
        frame = renderer.render(Pose.of(poses[t]))
        is_blank |= t == 0 and shows_nothing(frame.depth, frame.ids)
        writer.add_digest(frame.rgb, frame.depth, frame.ids)
    return is_blank


_EXCESS = 1.1
"""A rig is refused if the estimated size of its measurements exceeds this multiple of the limit."""


class LoadedSurroundings:
    """Scene of an episode for cameras and lidars: an open renderer with the scene, and its ray caster."""

    def __init__(self, scene: LoadedScene, renderer: Renderer) -> None:
        self._scene, self._renderer = scene, renderer

    def render_camera(self, pose: Pose, camera: Camera) -> CameraImage:
        """Returns the image of a camera, without noise, for a pose of base_link."""
        return self._renderer.render_camera(camera, pose)

    def rays(self) -> RayCaster:
        """Returns the ray caster of the scene; raises `UsageError` if embreex is not installed."""
        return self._scene.rays


def add_measurements(
    writer: BundleWriter,
    scene: LoadedSurroundings,
    job: Job,
    arrays: EpisodeArrays,
    on_measurement: Callable[[], None],
    change: CameraChange | None = None,
) -> None:
    """Measures and stores all sensors of a job's rig; does nothing without a rig.

    Args:
        writer: bundle with all frames.
        scene: scene of the job, loaded in the renderer.
        job: job, with rig, control rate and seed.
        arrays: arrays of the episode.
        on_measurement: called after each measurement.
        change: change of the cameras' poses, lenses and exposure by the appearance; `None` for unchanged cameras.

    Raises:
        UsageError: the renderer has no normals, which a camera needs, or embreex is not installed, which a lidar needs.
        WorldError: the bundle would exceed its largest size; raised before the first measurement if samples show it.
    """
    if job.view.rig is None:
        return
    track = Trajectory(
        arrays.poses,
        arrays.actions_continuous.astype(np.float64),
        control_hz=job.task.control_hz,
        seed=job.root_seed,
        episode=job.index,
    )
    require_room(job.view.rig, track, scene, MAX_BUNDLE_BYTES, change)
    for sensor in job.view.rig.sensors:
        for t, _specs in measurements_of(sensor, len(arrays.poses), job.task.control_hz):
            measurement: Measurement
            if isinstance(sensor, Imu | WheelOdometry):
                measurement = measure(sensor, track)
            else:
                assert t is not None, "a measurement of a camera or lidar needs a step"
                measurement = observe(changed_sensor(sensor, change), t, track, scene)
            try:
                writer.add_measurement(sensor, t, arrays_in(measurement))
            except ValueError as error:
                raise _too_large(job.view.rig, track, MAX_BUNDLE_BYTES) from error
            on_measurement()


def require_room(
    rig: Rig, track: Trajectory, scene: Surroundings, limit_bytes: int, change: CameraChange | None = None
) -> None:
    """Estimates the stored size of a rig from three measurements of each camera and lidar.

    Measures only if the arrays without compression exceed the limit.

    Raises:
        WorldError: the estimate exceeds the limit by more than a tenth; the message has the remedy.
    """
    length, hz = len(track.poses), track.control_hz
    seen = [(sensor, measured_steps(sensor, length, hz)) for sensor in rig.sensors if not is_of_motion(sensor)]
    if sum(len(steps) * _plain_bytes(sensor) for sensor, steps in seen) <= limit_bytes:
        return
    estimate = 0.0
    for sensor, steps in seen:
        chosen = sorted({steps[0], steps[len(steps) // 2], steps[-1]})
        sizes = [_stored_bytes(sensor, t, track=track, scene=scene, change=change) for t in chosen]
        estimate += len(steps) * sum(sizes) / len(sizes)
    if estimate > _EXCESS * limit_bytes:
        raise _too_large(rig, track, limit_bytes, f", which would store {estimate / 1e9:.1f} GB,")


def _plain_bytes(sensor: Sensor) -> int:
    """Returns the size of a measurement of a camera or lidar without compression, bytes."""
    specs = arrays_of(sensor).values()
    return sum(math.prod(side or 0 for side in spec.shape) * np.dtype(spec.dtype).itemsize for spec in specs)


def _stored_bytes(sensor: Sensor, t: int, track: Trajectory, scene: Surroundings, change: CameraChange | None) -> int:
    """Returns the size at which a measurement of a camera or lidar at step t is stored in the bundle, bytes."""
    assert not isinstance(sensor, Imu | WheelOdometry), (
        "motion sensors have no samples: they store only a few bytes for each step"
    )
    arrays, specs = arrays_in(observe(changed_sensor(sensor, change), t, track, scene)), arrays_of(sensor)
    return sum(len(encode_array(specs[name], array)) for name, array in arrays.items())


def _too_large(rig: Rig, track: Trajectory, limit_bytes: int, estimate: str = "") -> WorldError:
    return WorldError(
        f"{episode_id(track.episode)}: {len(track.poses)} steps of rig {rig.name!r}{estimate} do not fit into a bundle "
        f"of {limit_bytes / 1e9:.1f} GB: lower rate_hz, width and height, remove outputs or sensors, or keep states "
        "and render the rig when they are read: Dataset(path, rig=...)"
    )
