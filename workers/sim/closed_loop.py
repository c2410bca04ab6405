"""The closed loop of one episode, stepped from outside: slew limit, record, end, physics, view.

The one place where a drive is stepped: collection, evaluation and the Gymnasium environment stand on it. Drives nobody.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from schemas.bundle import EpisodeArrays
from schemas.job import Job
from schemas.scene import Target
from schemas.terms import EndReason
from schemas.tokens import tokens_of
from workers.experts.observation import LazyFrame, Observation
from workers.geometry.slew import Twist, slew
from workers.physics.world import World
from workers.render import Renderer
from workers.sim.termination import Termination

__all__ = ["ClosedLoop"]


class ClosedLoop:
    """`decide` on an action, then `advance`, until a decision ends the episode.

    Frame t and pose t are taken before action t; the last action is recorded, not carried out, so that every array
    has the length T and the poses alone prove the end (docs/design/data.md#bundle).

    Args:
        job: task, robot and camera settings.
        target: the object to approach.
        world: with the robot standing at its start.
        renderer: with the scene loaded; used when somebody looks.
    """

    def __init__(self, job: Job, target: Target, world: World, renderer: Renderer) -> None:
        self._job, self._target, self._world = job, target, world
        self._lent = _Lent(renderer)
        self._termination = Termination(job.task)
        self._poses: list[tuple[float, ...]] = []
        self._actions: list[Twist] = []
        self.command = Twist(0.0, 0.0)
        """The twist in force, after the slew limit."""
        self.contact_steps = 0
        """Steps with a contact other than the floor."""
        self.view = self._look()
        """What there is before the next action."""

    @property
    def steps(self) -> int:
        """Actions so far."""
        return len(self._actions)

    @property
    def track(self) -> NDArray[np.float64]:
        """(frames, 7) x, y, z, qw, qx, qy, qz of base_link of every frame so far."""
        return np.array(self._poses, np.float64)

    def arrays(self) -> EpisodeArrays:
        """Returns the steps so far as the archive has them: poses and actions of equal length."""
        continuous = np.array(self._actions, np.float32).reshape(-1, 2)
        poses = self.track[: len(continuous)].astype(np.float32)
        return EpisodeArrays(continuous, tokens_of(continuous), poses)

    def decide(self, wanted: Twist) -> EndReason | None:
        """Takes the action of the present view; returns why the episode ends with it, or `None` while it goes on.

        Args:
            wanted: within the robot's range, before the slew limit.
        """
        view, job = self.view, self._job
        self.command = slew(self.command, wanted, job.robot, 1.0 / job.task.control_hz)
        self._actions.append(self.command)
        self.contact_steps += view.is_touching
        end = self._judge(view)
        if end is not None:
            self.view = replace(view, end=end)
        return end

    def advance(self) -> None:
        """Carries the action out for one control period, and looks anew."""
        self._world.command(self.command.v_mps, self.command.w_rps)
        self._world.step()
        self.view = self._look()

    def leave(self) -> None:
        """From now on nothing is drawn any more, for the renderer may show another scene; what was drawn stays."""
        self._lent.take_back()

    def _judge(self, view: Observation) -> EndReason | None:
        """Looks for obstacles only where it matters: where there is no progress."""
        x, y, v = view.pose.x, view.pose.y, self.command.v_mps
        blocked = view.is_touching or (self._termination.would_stall(x, y, v) and view.obstacle_near)
        return self._termination.judge(x, y, view.distance_m, blocked, v)

    def _look(self) -> Observation:
        pose = self._world.pose()
        self._poses.append((pose.x, pose.y, pose.z, pose.qw, pose.qx, pose.qy, pose.qz))
        dx, dy = self._target.centroid_m[0] - pose.x, self._target.centroid_m[1] - pose.y
        return Observation(
            camera=LazyFrame(self._lent.renderer, pose, self._job, self._target.instance_id),
            pose=pose,
            distance_m=math.hypot(dx, dy),
            bearing_rad=math.remainder(math.atan2(dy, dx) - pose.yaw, 2 * math.pi),
            is_touching=self._world.has_obstacle_contact(),
        )


class _Lent:
    """The renderer while views may use it. Views hold this and not the loop, so that the last frame goes with it."""

    def __init__(self, renderer: Renderer) -> None:
        self._renderer: Renderer | None = renderer

    def renderer(self) -> Renderer:
        if self._renderer is None:
            raise RuntimeError("the episode of this view has ended; keep the frame, not the view")
        return self._renderer

    def take_back(self) -> None:
        self._renderer = None
