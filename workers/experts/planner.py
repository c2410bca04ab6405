"""Planner expert: plans a forward-only path on the occupancy grid and follows it with pure pursuit.

Design: docs/design/experts.md#planner.

Uses the map and not the image. Near the goal it applies the speed law and the stop of the proportional expert.
"""

from __future__ import annotations

import itertools

from schemas.job import Job
from schemas.measure import Goal
from schemas.scene import Target
from workers.experts.base import ExpertObservation
from workers.geometry.grid import Grid
from workers.geometry.pose import Pose
from workers.geometry.slew import Twist
from workers.planning import GoalFields, Waypoint, plan_path
from workers.planning.follow import Follower

_LAST_MARGIN_M = 0.01
"""At the end of its path, the robot stops if it is at least this far inside the edge of the success region, metres."""
STOPPED_M = 0.055
"""Measured distance inside the edge of the success region at which the robot comes to rest after braking, metres."""
_MOVING_MPS = 0.1
"""Speed above which a robot drives, m/s."""
_AHEAD_RAD = 0.6
"""If the target must be in view, the robot stops before the end of its path only while the bearing of the target's
centroid is at most this angle, radians. The edge of the image is at 0.79."""


def arrival_pose(path: tuple[Waypoint, ...], goal: Goal, stop_m: float) -> Waypoint:
    """Returns the pose on a path at which the robot comes within `stop_m` of its target, or else the last pose."""
    for before, after in itertools.pairwise(path):
        far, near = goal.distance(before.x, before.y), goal.distance(after.x, after.y)
        if near <= stop_m < far:
            share = (far - stop_m) / (far - near)
            return Waypoint(before.x + share * (after.x - before.x), before.y + share * (after.y - before.y), after.yaw)
    return path[-1]


class PlannerExpert:
    """Expert that plans a path at the start and then follows it."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self._stop_m = job.task.success_radius_m - job.planner.stop_margin_m
        self._faces = job.faces_target
        self._follower: Follower | None = None
        self._kept: GoalFields | None = None
        self._has_stopped = False

    def begin(self, start: Pose, grid: Grid, target: Target) -> tuple[Waypoint, ...] | None:
        """Plans from a start pose; returns the path, or `None` if none exists."""
        self._grid, self._target = grid, target
        path = self._plan(start)
        self._follower = None if path is None else Follower(path, self._job.robot, self._job.planner)
        return path

    def path_from(self, pose: Pose) -> tuple[Waypoint, ...] | None:
        """Returns a path from any pose, after `begin`; `None` if none exists. The path of `act` does not change."""
        self._keep_fields()
        return self._plan(pose)

    def resume(self, path: tuple[Waypoint, ...], speed_mps: float) -> None:
        """Replaces the path of `act`.

        Args:
            path: path from the current pose, by `path_from`.
            speed_mps: speed of the robot, m/s.
        """
        self._follower, self._has_stopped = self._follow(path, speed_mps), False

    def action_at(self, seen: ExpertObservation, speed_mps: float) -> Twist | None:
        """Returns the twist that the planner wants at any pose, after `begin`; `None` if it has no path from there.

        It depends on the pose and the speed only, not on earlier steps, so a label can be computed again. The path of
        `act` does not change.

        Args:
            seen: observation at the pose; its images are not read.
            speed_mps: speed of the robot, m/s.
        """
        path = self.path_from(seen.pose)
        return None if path is None else self.action_on(path, seen, speed_mps)

    def action_on(self, path: tuple[Waypoint, ...], seen: ExpertObservation, speed_mps: float) -> Twist:
        """Returns `action_at` for a path that `path_from` returned at the same pose."""
        follower = self._follow(path, speed_mps)
        if self._has_arrived(seen, is_done=follower.is_done):
            return Twist(0.0, 0.0)
        return follower.act(seen.pose, self._job.gains.speed_gain * seen.distance_m)

    def _keep_fields(self) -> None:
        if self._kept is None:
            self._kept = GoalFields(self._grid, self._target, self._job.task, facing=self._faces)

    def _plan(self, pose: Pose) -> tuple[Waypoint, ...] | None:
        start, job = Waypoint(pose.x, pose.y, pose.yaw), self._job
        return plan_path(self._grid, start, self._target, job.task, job.planner, facing=self._faces, kept=self._kept)

    def _follow(self, path: tuple[Waypoint, ...], speed_mps: float) -> Follower:
        return Follower(path, self._job.robot, self._job.planner, is_moving=speed_mps > _MOVING_MPS)

    def act(self, seen: ExpertObservation) -> Twist:
        """Returns the desired twist; zero after arrival inside the success region with line of sight to the target.

        Raises:
            RuntimeError: `begin` was not called or found no path.
        """
        if self._follower is None:
            raise RuntimeError("act() has no path; call begin() first, and act() only if begin() found a path")
        self._has_stopped = self._has_stopped or self._has_arrived(seen, is_done=self._follower.is_done)
        if self._has_stopped:
            return Twist(0.0, 0.0)
        return self._follower.act(seen.pose, self._job.gains.speed_gain * seen.distance_m)

    def _has_arrived(self, seen: ExpertObservation, *, is_done: bool) -> bool:
        """Returns whether the robot is close to the target and sees it; without sight it could stop behind a wall.

        Args:
            seen: observation.
            is_done: whether the robot is at the end of its path.
        """
        if self._faces and not is_done and abs(seen.bearing_rad) > _AHEAD_RAD:
            return False
        near_enough_m = self._job.task.success_radius_m - _LAST_MARGIN_M if is_done else self._stop_m
        return seen.distance_m <= near_enough_m and self._grid.has_sight((seen.pose.x, seen.pose.y), self._target)
