"""Simulator of evaluation episodes: starts at the pose of a spec, then runs the closed loop used for data collection.

The caller supplies the actions: experts, policies and the Gymnasium environment. Computes no metrics.
"""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np
from numpy.typing import NDArray

from factory.eval.models.spec import EvalSettings, EvalSpec
from schemas.appearance import Appearance
from schemas.bundle import EpisodeArrays
from schemas.errors import WorldError
from schemas.scene import Target
from schemas.support.closing import Closing
from workers.experts.observation import Observation
from workers.geometry.pose import Pose
from workers.geometry.slew import Twist
from workers.physics.world import World
from workers.sensors.observation import Trajectory
from workers.sim.appearance import show_appearance
from workers.sim.closed_loop import ClosedLoop
from workers.sim.context import LoadedScene, SimulationContext
from workers.sim.recording import LoadedSurroundings
from workers.sim.spawn import is_spawn_stable


class UnstableStart(WorldError):
    """The robot is not stable at the start pose of a spec."""


class Simulator(Closing):
    """Simulator of one episode at a time: call `reset`, then `step` until the `end` of the view is set.

    It is a context manager.
    """

    def __init__(
        self, context: SimulationContext, settings: EvalSettings, appearance: Appearance | None = None
    ) -> None:
        """Stores the scene renderer, which the caller opens and closes, and the appearance of the episodes."""
        self._context, self._appearance = context, appearance
        self.settings = settings
        self._held = ExitStack()
        self._loop: ClosedLoop | None = None

    def close(self) -> None:
        """Closes the simulation of the last episode; the scene renderer stays open."""
        self._held.close()
        self._loop = None

    def reset(self, spec: EvalSpec, loaded: LoadedScene) -> Observation:
        """Places the robot at the start pose of an episode and returns the first view.

        Args:
            spec: Spec of the episode.
            loaded: Scene of the spec.

        Raises:
            UnstableStart: The robot is not stable at the start pose.
            WorldError: The scene does not have the target.
        """
        self.close()
        self.spec, self.loaded = spec, loaded
        self.target = _target(spec, loaded)
        job, scene = spec.job(self.settings), loaded.compiled
        world = self._held.enter_context(World(scene, loaded.collider, job.robot, job.task.control_hz))
        x, y, yaw = spec.spawn_pose
        if not is_spawn_stable(world, Pose.planar(x, y, yaw, z=scene.info.floor_height_m), job):
            where = f"({x:.2f}, {y:.2f}) m, yaw {yaw:.2f} rad"
            raise UnstableStart(
                f"{spec.spec_id}: the robot is not stable at its start in {spec.scene}, {where}; create new specs"
            )
        pose = np.array(((x, y, 0.0, 1.0, 0.0, 0.0, 0.0),))
        self.shown = show_appearance(job, self._appearance, scene=loaded, renderer=self._context.renderer, poses=pose)
        self._loop = ClosedLoop(job, self.target, world, self.shown.renderer)
        self._held.callback(self._loop.leave)
        return self._loop.view

    def step(self, wanted: Twist) -> Observation:
        """Records a twist as the next action, and simulates one control period unless this action ends the episode.

        Args:
            wanted: Twist before the slew limit; values outside of the robot's range are clipped.

        Raises:
            RuntimeError: No episode is running.
        """
        loop = self._running
        if loop.view.end is not None:
            raise RuntimeError("step() was called after the end of the episode; call reset() first")
        if loop.decide(self._within_bounds(wanted)) is None:
            loop.advance()
        return loop.view

    @property
    def steps(self) -> int:
        """Number of executed actions."""
        return self._running.steps

    @property
    def command(self) -> Twist:
        return self._running.command

    @property
    def contact_steps(self) -> int:
        """Number of steps with a contact other than the floor."""
        return self._running.contact_steps

    @property
    def track(self) -> NDArray[np.float64]:
        """(frames, 7) poses of base_link up to the current frame: x, y, z, qw, qx, qy, qz."""
        return self._running.track

    def arrays(self) -> EpisodeArrays:
        """Returns the recorded arrays of the steps so far: poses and actions of equal length."""
        return self._running.arrays()

    def trajectory(self) -> Trajectory:
        """Returns the states of the steps so far, from which the sensors of a rig are measured."""
        track = self.track
        twists = np.zeros((len(track), 2))
        twists[: self.steps] = self.arrays().actions_continuous
        return Trajectory(track, twists, self.settings.task.control_hz, self.spec.seed, episode=1)

    @property
    def surroundings(self) -> LoadedSurroundings:
        """Scene of the episode for cameras and lidars."""
        return LoadedSurroundings(self.shown.scene, self.shown.renderer)

    def observe(self) -> Observation:
        """Returns the current view, which contains ground truth and must not be passed to a model."""
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


def _target(spec: EvalSpec, loaded: LoadedScene) -> Target:
    try:
        return loaded.compiled.info.target(spec.target_id)
    except KeyError as error:
        raise WorldError(
            f"{spec.spec_id}: scene {spec.scene} has no target {spec.target_id}; create new specs"
        ) from error
