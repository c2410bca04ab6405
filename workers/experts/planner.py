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
from workers.planning import Waypoint, plan_path
from workers.planning.follow import Follower

_LAST_MARGIN_M = 0.01
"""At the end of its path, the robot stops if it is at least this far inside the edge of the success region, metres."""
STOPPED_M = 0.055
"""Measured distance inside the edge of the success region at which the robot comes to rest after braking, metres."""
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
        self._faces = job.demonstration.target_in_view
        self._follower: Follower | None = None
        self._has_stopped = False

    def begin(self, start: Pose, grid: Grid, target: Target) -> tuple[Waypoint, ...] | None:
        """Plans from a start pose; returns the path, or `None` if none exists."""
        self._grid, self._target = grid, target
        pose = Waypoint(start.x, start.y, start.yaw)
        path = plan_path(grid, pose, target=target, task=self._job.task, config=self._job.planner, facing=self._faces)
        self._follower = None if path is None else Follower(path, self._job.robot, self._job.planner)
        return path

    def act(self, seen: ExpertObservation) -> Twist:
        """Returns the desired twist; zero after arrival inside the success region with line of sight to the target.

        Raises:
            RuntimeError: `begin` was not called or found no path.
        """
        if self._follower is None:
            raise RuntimeError("act() has no path; call begin() first, and act() only if begin() found a path")
        self._has_stopped = self._has_stopped or self._has_arrived(seen)
        if self._has_stopped:
            return Twist(0.0, 0.0)
        return self._follower.act(seen.pose, self._job.gains.speed_gain * seen.distance_m)

    def _has_arrived(self, seen: ExpertObservation) -> bool:
        """Returns whether the robot is close to the target and sees it; without sight it could stop behind a wall."""
        is_done = self._follower is not None and self._follower.is_done
        if self._faces and not is_done and abs(seen.bearing_rad) > _AHEAD_RAD:
            return False
        near_enough_m = self._job.task.success_radius_m - _LAST_MARGIN_M if is_done else self._stop_m
        return seen.distance_m <= near_enough_m and self._grid.has_sight((seen.pose.x, seen.pose.y), self._target)
