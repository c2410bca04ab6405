"""The closed loop, stepped from outside: same world, camera, slew limit and end of episode as a collected rollout.

Drives nobody and measures nothing; experts, policies and the Gymnasium environment all stand on it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cached_property
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from factory.eval.spec import EvalSettings, EvalSpec
from schemas.bundle import EpisodeArrays
from schemas.errors import WorldError
from schemas.scene import Target
from schemas.terms import EndReason
from schemas.tokens import tokens_of
from workers import experts
from workers.pose import Pose
from workers.render import Frame, Relief, Renderer
from workers.sight import Sighting, is_obstacle_near, see
from workers.slew import Twist, slew
from workers.spawn import is_spawn_firm
from workers.stage import LoadedScene, Stage
from workers.termination import Termination
from workers.world import World

__all__ = ["Camera", "NoFirmStand", "Simulator", "View"]

Floats = NDArray[np.float64]


class NoFirmStand(WorldError):
    """The robot does not stand firm at the start of a spec."""


class Camera:
    """What the camera shows from one pose; drawn when somebody first looks, for most drivers never do.

    Args:
        draw: draws all of it.
        draw_relief: draws it without colour, for those that need none.
        settings: what counts as visible and as near.
        instance_id: of the target.
    """

    def __init__(
        self,
        draw: Callable[[], Frame],
        draw_relief: Callable[[], Relief],
        settings: EvalSettings,
        instance_id: int,
    ) -> None:
        self._draw, self._draw_relief = draw, draw_relief
        self._settings, self._instance_id = settings, instance_id

    @cached_property
    def frame(self) -> Frame:
        """Colour, depth and ids."""
        return self._draw()

    @cached_property
    def relief(self) -> Frame | Relief:
        """Depth and ids."""
        return self.frame if "frame" in self.__dict__ else self._draw_relief()

    @cached_property
    def sighting(self) -> Sighting:
        """The target in the image."""
        return see(self.relief.ids, self.relief.depth, self._instance_id, self._settings.gains.min_mask_px)

    @cached_property
    def obstacle_near(self) -> bool:
        """Whether something stands close before it."""
        return is_obstacle_near(self.relief.depth, self._settings.task)


@dataclass(frozen=True)
class View:
    """What there is before an action; after the end, what the last action was judged on. An expert's senses."""

    camera: Camera
    pose: Pose
    """Of base_link in the world frame."""
    distance_m: float
    """Planar, from base_link to the target's centroid."""
    bearing_rad: float
    """From the robot's heading to the target's centroid, counter-clockwise, in [-pi, pi]."""
    is_touching: bool
    """Whether there is a contact other than the floor."""
    end: EndReason | None = None
    """Why the episode has ended, or `None` while it goes on."""

    @property
    def frame(self) -> Frame:
        """What the camera shows."""
        return self.camera.frame

    @property
    def sighting(self) -> Sighting:
        """The target in the image."""
        return self.camera.sighting

    @property
    def obstacle_near(self) -> bool:
        """Whether something stands close before the camera."""
        return self.camera.obstacle_near


class Simulator:
    """One episode at a time; `reset`, then `step` until a view has an end. A context manager."""

    def __init__(self, stage: Stage, settings: EvalSettings) -> None:
        """Keeps the caller's open stage, whose renderer it uses."""
        self._stage = stage
        self.settings = settings
        self._held = ExitStack()
        self._view: View | None = None
        self._episodes = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Frees the world of the last episode; the stage stays open."""
        self._held.close()
        self._view = None

    def reset(self, spec: EvalSpec, place: LoadedScene) -> View:
        """Puts the robot at the start of an episode and returns the first view.

        Args:
            spec: the episode.
            place: its scene, loaded.

        Raises:
            NoFirmStand: the robot does not stand firm there.
            WorldError: the scene has no such target.
        """
        self.close()
        self._episodes += 1
        self.spec, self.place = spec, place
        self.target = _target(spec, place)
        self._job = spec.job(self.settings)
        self._termination = Termination(self.settings.task)
        self._command = Twist(0.0, 0.0)
        self._poses: list[tuple[float, ...]] = []
        self._actions: list[Twist] = []
        self.contact_steps = 0
        self._world = self._held.enter_context(
            World(place.scene, place.collider, self.settings.robot, self.settings.task.control_hz)
        )
        x, y, yaw = spec.spawn_pose
        start = Pose.planar(x, y, yaw, z=place.scene.info.floor_height_m)
        if not is_spawn_firm(self._world, start, self._job):
            where = f"({x:.2f}, {y:.2f}) m, yaw {yaw:.2f} rad"
            raise NoFirmStand(
                f"{spec.spec_id}: the robot does not stand firm in {spec.scene} at {where}; make new specs"
            )
        self._stage.renderer.load(place.scene, self.settings.camera)
        self._view = self._look()
        return self._view

    def step(self, wanted: Twist) -> View:
        """Asks for a twist and simulates one period, unless the episode ends with this action.

        Args:
            wanted: before the slew limit; speeds beyond the robot's are cut to its range.

        Raises:
            RuntimeError: there is no episode, or it has ended.
        """
        view = self._view
        if view is None or view.end is not None:
            raise RuntimeError("step() without a running episode; call reset() first")
        self._command = slew(self._command, self._within_bounds(wanted), self.settings.robot, self.period_s)
        self._actions.append(self._command)
        self.contact_steps += view.is_touching
        end = self._judge(view)
        if end is not None:
            self._view = replace(view, end=end)
            return self._view
        self._world.command(self._command.v_mps, self._command.w_rps)
        self._world.step()
        self._view = self._look()
        return self._view

    @property
    def period_s(self) -> float:
        """Length of a step in seconds."""
        return 1.0 / self.settings.task.control_hz

    @property
    def steps(self) -> int:
        """Actions so far."""
        return len(self._actions)

    @property
    def command(self) -> Twist:
        """The twist in force, after the slew limit."""
        return self._command

    @property
    def track(self) -> Floats:
        """(frames, 7) x, y, z, qw, qx, qy, qz of base_link of every frame so far, float64."""
        return np.array(self._poses, np.float64)

    def arrays(self) -> EpisodeArrays:
        """Returns the steps so far as the archive has them: poses and actions of equal length."""
        continuous = np.array(self._actions, np.float32).reshape(-1, 2)
        poses = self.track[: len(continuous)].astype(np.float32)
        return EpisodeArrays(continuous, tokens_of(continuous), poses)

    def observe(self) -> experts.Senses:
        """Returns what an expert is shown of the present view: ground truth, never given to a model."""
        if self._view is None:
            raise RuntimeError("observe() without an episode; call reset() first")
        return self._view

    def _judge(self, view: View) -> EndReason | None:
        """Looks for obstacles only where it matters: where there is no progress."""
        x, y, v = view.pose.x, view.pose.y, self._command.v_mps
        blocked = view.is_touching or (self._termination.would_stall(x, y, v) and view.obstacle_near)
        return self._termination.judge(x, y, view.distance_m, blocked, v)

    def _within_bounds(self, wanted: Twist) -> Twist:
        robot = self.settings.robot
        return Twist(
            min(max(wanted.v_mps, 0.0), robot.max_speed_mps),
            min(max(wanted.w_rps, -robot.max_yaw_rate_rps), robot.max_yaw_rate_rps),
        )

    def _look(self) -> View:
        pose = self._world.pose()
        self._poses.append((pose.x, pose.y, pose.z, pose.qw, pose.qx, pose.qy, pose.qz))
        dx, dy = self.target.centroid_m[0] - pose.x, self.target.centroid_m[1] - pose.y
        episode = self._episodes
        return View(
            camera=Camera(
                lambda: self._renderer(episode).render(pose),
                lambda: self._renderer(episode).render_relief(pose),
                self.settings,
                self.target.instance_id,
            ),
            pose=pose,
            distance_m=math.hypot(dx, dy),
            bearing_rad=math.remainder(math.atan2(dy, dx) - pose.yaw, 2 * math.pi),
            is_touching=self._world.has_obstacle_contact(),
        )

    def _renderer(self, episode: int) -> Renderer:
        if episode != self._episodes:
            raise RuntimeError("a view of an episode that is over is looked at; keep its frame, not the view")
        return self._stage.renderer


def _target(spec: EvalSpec, place: LoadedScene) -> Target:
    try:
        return place.scene.info.target(spec.target_id)
    except KeyError as error:
        raise WorldError(
            f"{spec.spec_id}: scene {spec.scene} has no target {spec.target_id}; make new specs"
        ) from error
