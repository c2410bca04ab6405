"""Records the measurements of a rig along a driven trajectory, sensor by sensor, in the bundle of an episode.

Does not drive. A measurement is a function of scene, sensor, trajectory and seed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from schemas.appearance import CameraChange
from schemas.bundle import MAX_BUNDLE_BYTES, BundleWriter, EpisodeArrays
from schemas.errors import WorldError
from schemas.job import Job
from schemas.rig import Camera, Imu, WheelOdometry
from schemas.rig.measurements import measurements_of
from workers.appearance import changed_sensor
from workers.geometry.pose import Pose
from workers.render import CameraImage, Renderer
from workers.sensors.lidar import RayCaster
from workers.sensors.observation import Observation, Trajectory, arrays_in, measure, observe
from workers.sim.scene_renderer import LoadedScene


class LoadedSurroundings:
    """Scene of an episode for cameras and lidars: an open renderer with the scene, and its ray caster."""

    def __init__(self, place: LoadedScene, renderer: Renderer) -> None:
        self._place, self._renderer = place, renderer

    def render_camera(self, pose: Pose, camera: Camera) -> CameraImage:
        """Returns the image of a camera, without noise, for a pose of base_link."""
        return self._renderer.render_camera(camera, pose)

    def rays(self) -> RayCaster:
        """Returns the ray caster of the scene; raises `UsageError` if embreex is not installed."""
        return self._place.rays


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
        job: gives rig, control rate and seed.
        arrays: arrays of the episode.
        on_measurement: called after each measurement.
        change: change of the cameras.

    Raises:
        UsageError: the renderer has no normals, which a camera needs, or embreex is not installed, which a lidar needs.
        WorldError: the bundle would exceed its largest size.
    """
    if job.view.rig is None:
        return
    track = Trajectory(
        arrays.poses, arrays.actions_continuous.astype(np.float64), job.task.control_hz, job.root_seed, job.index
    )
    for sensor in job.view.rig.sensors:
        for t, _specs in measurements_of(sensor, len(arrays.poses), job.task.control_hz):
            found: Observation
            if isinstance(sensor, Imu | WheelOdometry):
                found = measure(sensor, track)
            else:
                assert t is not None, "only a sensor of motion has no step"
                found = observe(changed_sensor(sensor, change), t, track, scene)
            try:
                writer.add_measurement(sensor, t, arrays_in(found))
            except ValueError as error:
                raise WorldError(
                    f"{job.episode_id}: the rig {job.view.rig.name!r} does not fit into a bundle of "
                    f"{MAX_BUNDLE_BYTES / 1e9:.1f} GB: reduce sensors, outputs, rates or resolutions, or keep states "
                    "and read the rig from them"
                ) from error
            on_measurement()
