"""Episodes of evaluation, stepped from outside: a spec's start, then the same closed loop as a collected rollout.

Drives nobody and measures nothing; experts, policies and the Gymnasium environment all stand on it.
"""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np
from numpy.typing import NDArray

from factory.eval.models.spec import EvalSettings, EvalSpec
from schemas.bundle import EpisodeArrays
from schemas.errors import WorldError
from schemas.scene import Target
from schemas.support.closing import Closing
from workers.experts.observation import Observation
from workers.geometry.pose import Pose
from workers.geometry.slew import Twist
from workers.physics.world import World
from workers.sim.closed_loop import ClosedLoop
from workers.sim.scene_renderer import LoadedScene, SceneRenderer
from workers.sim.spawn import is_spawn_stable

__all__ = ["NoFirmStand", "Simulator"]


class NoFirmStand(WorldError):
    """The robot does not stand firm at the start of a spec."""


class Simulator(Closing):
    """One episode at a time; `reset`, then `step` until a view has an end. A context manager."""

    def __init__(self, stage: SceneRenderer, settings: EvalSettings) -> None:
        """Keeps the caller's open stage, whose renderer it uses."""
        self._stage = stage
        self.settings = settings
        self._held = ExitStack()
        self._loop: ClosedLoop | None = None

    def close(self) -> None:
        """Frees the world of the last episode; the stage stays open."""
        self._held.close()
        self._loop = None

    def reset(self, spec: EvalSpec, place: LoadedScene) -> Observation:
        """Puts the robot at the start of an episode and returns the first view.

        Args:
            spec: the episode.
            place: its scene, loaded.

        Raises:
            NoFirmStand: the robot does not stand firm there.
            WorldError: the scene has no such target.
        """
        self.close()
        self.spec, self.place = spec, place
        self.target = _target(spec, place)
        job, scene = spec.job(self.settings), place.scene
        world = self._held.enter_context(World(scene, place.collider, job.robot, job.task.control_hz))
        x, y, yaw = spec.spawn_pose
        if not is_spawn_stable(world, Pose.planar(x, y, yaw, z=scene.info.floor_height_m), job):
            where = f"({x:.2f}, {y:.2f}) m, yaw {yaw:.2f} rad"
            raise NoFirmStand(
                f"{spec.spec_id}: the robot is not stable at its start in {spec.scene}, {where}; create new specs"
            )
        self._stage.renderer.load(scene, job.camera)
        self._loop = ClosedLoop(job, self.target, world, self._stage.renderer)
        self._held.callback(self._loop.leave)
        return self._loop.view

    def step(self, wanted: Twist) -> Observation:
        """Asks for a twist and simulates one period, unless the episode ends with this action.

        Args:
            wanted: before the slew limit; speeds beyond the robot's are cut to its range.

        Raises:
            RuntimeError: there is no episode, or it has ended.
        """
        loop = self._running
        if loop.view.end is not None:
            raise RuntimeError("step() after the end of the episode; call reset() first")
        if loop.decide(self._within_bounds(wanted)) is None:
            loop.advance()
        return loop.view

    @property
    def steps(self) -> int:
        """Actions so far."""
        return self._running.steps

    @property
    def command(self) -> Twist:
        """The twist in force, after the slew limit."""
        return self._running.command

    @property
    def contact_steps(self) -> int:
        """Steps with a contact other than the floor."""
        return self._running.contact_steps

    @property
    def track(self) -> NDArray[np.float64]:
        """(frames, 7) x, y, z, qw, qx, qy, qz of base_link of every frame so far."""
        return self._running.track

    def arrays(self) -> EpisodeArrays:
        """Returns the steps so far as the archive has them: poses and actions of equal length."""
        return self._running.arrays()

    def observe(self) -> Observation:
        """Returns the present view: ground truth, never given to a model."""
        return self._running.view

    @property
    def _running(self) -> ClosedLoop:
        if self._loop is None:
            raise RuntimeError("no episode is running; call reset() first")
        return self._loop

    def _within_bounds(self, wanted: Twist) -> Twist:
        robot = self.settings.robot
        return Twist(
            min(max(wanted.v_mps, 0.0), robot.max_speed_mps),
            min(max(wanted.w_rps, -robot.max_yaw_rate_rps), robot.max_yaw_rate_rps),
        )


def _target(spec: EvalSpec, place: LoadedScene) -> Target:
    try:
        return place.scene.info.target(spec.target_id)
    except KeyError as error:
        raise WorldError(
            f"{spec.spec_id}: scene {spec.scene} has no target {spec.target_id}; create new specs"
        ) from error
