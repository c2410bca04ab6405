"""Closed loop of one episode, advanced by the caller: slew limit, recording, physics, observation, termination.

Collection, evaluation and the Gymnasium environment share this loop and its termination conditions (success, collision
and timeout). It contains no controller.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from schemas.bundle import EpisodeArrays
from schemas.config import TaskConfig
from schemas.job import Job
from schemas.measure import STOPPED_RPS, Goal, hold_steps_of
from schemas.scene import Target
from schemas.terms import EndReason
from schemas.tokens import tokens_of
from workers.experts.observation import Observation
from workers.geometry.slew import Twist, slew
from workers.physics.world import World
from workers.render import Renderer


class Termination:
    """Evaluates the frames of one episode in order (paper Sec. II-A; docs/design/task.md#ends-of-an-episode).

    A frame is evaluated before its action is executed. Success requires `hold_steps` consecutive frames inside the
    radius with a measured speed below the limit, so it can be verified from the recorded poses alone.
    """

    def __init__(self, task: TaskConfig, hold_steps: int | None = None) -> None:
        self._task = task
        self._hold_steps = task.hold_steps if hold_steps is None else hold_steps
        self._held = 0
        self._frames = 0
        self._forward = 0
        self._track: deque[tuple[float, float]] = deque(maxlen=task.stall_steps + 1)

    def evaluate(
        self, x_m: float, y_m: float, distance_m: float, is_blocked: bool, commanded_mps: float
    ) -> EndReason | None:
        """Evaluates the next frame.

        Args:
            x_m: x of base_link in the world frame, metres.
            y_m: y of base_link in the world frame, metres.
            distance_m: planar distance to the target by the success measure, metres.
            is_blocked: whether the robot has a contact or an obstacle is near.
            commanded_mps: speed of the action of this frame, m/s.

        Returns:
            Reason if the episode ends with this frame, else `None`.
        """
        is_stalled = self.would_stall(x_m, y_m, commanded_mps)
        self._frames += 1
        self._track.append((x_m, y_m))
        self._held = self._held + 1 if self._is_stationary() and distance_m <= self._task.success_radius_m else 0
        self._forward = self._forward + 1 if commanded_mps > 0 else 0
        if self._held >= self._hold_steps:
            return EndReason.SUCCESS
        if is_blocked and is_stalled:
            return EndReason.COLLISION
        return EndReason.TIMEOUT if self._frames >= self._task.max_steps else None

    def would_stall(self, x_m: float, y_m: float, commanded_mps: float) -> bool:
        """Returns whether a robot that is commanded forward makes no progress in the steps up to the next frame.

        If it returns `False`, `evaluate` ignores `is_blocked`.

        Args:
            x_m: x of base_link in the next frame, metres.
            y_m: y of base_link in the next frame, metres.
            commanded_mps: speed of its action, m/s.
        """
        steps = self._task.stall_steps
        if commanded_mps <= 0 or self._forward + 1 < steps or len(self._track) < steps:
            return False
        return math.dist((x_m, y_m), self._track[-steps]) < self._task.stall_progress_m

    def _is_stationary(self) -> bool:
        if len(self._track) < 2:
            return False
        moved_m = math.dist(self._track[-1], self._track[-2])
        return moved_m * self._task.control_hz < self._task.stationary_speed_mps


# collection and evaluation share this loop: two loops would be known to be equal only in the cases that a test compares
class ClosedLoop:
    """Closed loop of one episode: the caller calls `decide` with an action, then `advance`, until `decide` ends it.

    Frame t and pose t are taken before action t; the last action is recorded, not carried out, so every array
    has the length T and the end can be verified from the poses alone (docs/design/data.md#bundle).

    Args:
        job: task, robot and camera settings.
        target: target to approach.
        world: world with the robot at its start pose.
        renderer: renderer with the scene loaded; used when an image is accessed.
    """

    def __init__(self, job: Job, target: Target, world: World, renderer: Renderer) -> None:
        self._job, self._target, self._world = job, target, world
        self._renderer = _RendererHandle(renderer)
        self._goal = Goal.of(target, job.task)
        self._termination = Termination(job.task, hold_steps_of(job, job.task))
        self._poses: list[tuple[float, ...]] = []
        self._actions: list[Twist] = []
        self.command = Twist(0.0, 0.0)
        """Current commanded twist, after the slew limit."""
        self.contact_steps = 0
        """Number of steps in which the robot touched anything other than the floor."""
        self.view = self._observe()
        """Observation before the next action."""

    @property
    def steps(self) -> int:
        return len(self._actions)

    @property
    def track(self) -> NDArray[np.float64]:
        """(frames, 7) poses x, y, z, qw, qx, qy, qz of base_link in the world at every frame so far."""
        return np.array(self._poses, np.float64)

    def arrays(self) -> EpisodeArrays:
        """Returns the recorded arrays of the steps so far: poses and actions of equal length."""
        continuous = np.array(self._actions, np.float32).reshape(-1, 2)
        return EpisodeArrays(continuous, tokens_of(continuous), self.track[: len(continuous)])

    def decide(self, wanted: Twist) -> EndReason | None:
        """Records the action for the current observation; returns the reason if the episode ends with it, else `None`.

        Args:
            wanted: desired twist within the robot's limits, before the slew limit.
        """
        view, job = self.view, self._job
        self.command = slew(self.command, wanted, job.robot, 1.0 / job.task.control_hz)
        self._actions.append(self.command)
        self.contact_steps += view.is_touching
        end = self._end_reason(view)
        if end is not None:
            view.end = end
        return end

    def advance(self) -> None:
        """Executes the action for one control period, and updates the observation."""
        self._world.command(self.command.v_mps, self.command.w_rps)
        self._world.step()
        self.view = self._observe()

    def leave(self) -> None:
        """Releases the renderer, which may load another scene; images that were rendered stay accessible."""
        self._renderer.release()

    def _end_reason(self, view: Observation) -> EndReason | None:
        """Returns the reason for the end, or `None`; renders an image only if the robot makes no progress."""
        x, y, v = view.pose.x, view.pose.y, self.command.v_mps
        blocked = view.is_touching or (self._termination.would_stall(x, y, v) and view.obstacle_near)
        return self._termination.evaluate(x, y, self._distance_m(view), blocked, v)

    def _distance_m(self, view: Observation) -> float:
        """Returns the distance to the goal, metres.

        With a false premise the goal is to stop at the start, so this is the distance to the start. It is infinite
        while the robot turns, because a turning robot has not stopped.
        """
        # Design: docs/design/language.md#success-of-a-false-premise.
        if not self._job.is_false_premise:
            return view.distance_m
        return math.inf if abs(self.command.w_rps) > STOPPED_RPS else math.dist(self._poses[0][:2], self._poses[-1][:2])

    def _observe(self) -> Observation:
        pose = self._world.pose()
        self._poses.append((pose.x, pose.y, pose.z, pose.qw, pose.qx, pose.qy, pose.qz))
        dx, dy = self._target.centroid_m[0] - pose.x, self._target.centroid_m[1] - pose.y
        return Observation(
            renderer=self._renderer.get,
            job=self._job,
            instance_id=self._target.instance_id,
            pose=pose,
            distance_m=self._goal.distance(pose.x, pose.y),
            bearing_rad=math.remainder(math.atan2(dy, dx) - pose.yaw, 2 * math.pi),
            is_touching=self._world.has_obstacle_contact(),
        )


class _RendererHandle:
    """Releasable reference to the renderer. Observations hold it instead of the loop, so old frames are freed."""

    # otherwise only the cyclic garbage collector would free them, and a call of it takes 50 ms

    def __init__(self, renderer: Renderer) -> None:
        self._renderer: Renderer | None = renderer

    def get(self) -> Renderer:
        if self._renderer is None:
            raise RuntimeError("the episode of this view has ended; keep the frame, not the view")
        return self._renderer

    def release(self) -> None:
        self._renderer = None
