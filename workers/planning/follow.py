"""Pure pursuit controller for a planned path: drives its legs, turns on the spot between them, and slows down in bends.

Independent of the simulation. Does not decide whether the goal is reached, and does not drive backwards.
"""

from __future__ import annotations

import functools
import itertools
import math
from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from schemas.config import PlannerConfig, RobotConfig
from schemas.support.numpy_types import Floats
from workers.geometry.pose import Pose
from workers.geometry.slew import Twist
from workers.planning.lattice import Waypoint

_ALIGNED_RAD, _LOST_RAD = 0.10, 0.9
"""Heading errors, radians. A turn on the spot ends when the error is below the first value. A driving robot turns on
the spot when the error is above the second value."""
_LEG_END_M = 0.04
"""Distance to the end of a leg at which the next leg starts, metres."""
_SLOWEST_MPS = 0.15
"""Smallest speed, m/s; stall detection would report a slower robot as stalled."""
_LEG_BRAKING_MPS2, _TURN_BRAKING_RPS2 = 0.8, 1.8
"""Planned decelerations of speed, m/s2, and yaw rate, rad/s2; well below the slew limits."""
_PREVIEW_M = 0.6
"""Length of the path ahead whose curvature limits the speed, metres."""
_REACH_M = 0.5
"""Largest distance along the leg by which the nearest point advances in one step, metres."""
_STEPS = np.arange(26.0)
"""Numbers of the evenly spaced points of a leg among which `Leg.nearest` finds the nearest one."""


@dataclass(frozen=True, eq=False)
class Leg:
    """Part of a path without a turn on the spot."""

    points: Floats
    """(N, 2) world x, y, metres."""
    along: Floats
    """(N,) length from the leg's start, metres."""
    yaw: Floats
    """(N,) heading, radians, unwrapped."""
    turn_rad: float
    """Turn on the spot before the leg, radians, counter-clockwise positive; this direction is known to be free."""

    @property
    def length_m(self) -> float:
        """Length from the first point to the last, metres."""
        return float(self.along[-1])

    def at(self, along_m: float) -> tuple[float, float]:
        """Returns x, y of the point at a length along the leg, metres; the leg extends straight beyond its end."""
        along, x, y, yaw = self._lists
        beyond = max(0.0, along_m - along[-1])
        return (
            interpolate(along_m, along, x) + beyond * math.cos(yaw[-1]),
            interpolate(along_m, along, y) + beyond * math.sin(yaw[-1]),
        )

    def curvature(self, along_m: float) -> float:
        """Returns the mean curvature over the preview length after `along_m`, 1/m."""
        along, _, _, yaw = self._lists
        return abs(interpolate(along_m + _PREVIEW_M, along, yaw) - interpolate(along_m, along, yaw)) / _PREVIEW_M

    def nearest(self, x: float, y: float, from_m: float) -> float:
        """Returns the length along the leg of the point nearest to (x, y), at least `from_m`, metres."""
        to_m = min(from_m + _REACH_M, self.length_m)
        candidates = _STEPS * ((to_m - from_m) / _STEPS[-1]) + from_m  # as `numpy.linspace`, in a third of its time
        candidates[-1] = to_m
        px, py = (np.interp(candidates, self.along, column) for column in self._columns)
        return float(candidates[((px - x) ** 2 + (py - y) ** 2).argmin()])

    @functools.cached_property
    def _columns(self) -> tuple[Floats, Floats]:
        x, y = self.points.T.copy()
        return x, y

    @functools.cached_property
    def _lists(self) -> tuple[list[float], ...]:
        return tuple(column.tolist() for column in (self.along, *self._columns, self.yaw))


def interpolate(place: float, places: list[float], values: list[float]) -> float:
    """Returns the value of `numpy.interp` at one place, bit for bit; for a single place, this function is faster."""
    before = bisect_right(places, place) - 1
    if before < 0 or before + 1 == len(places) or places[before] == place:
        return values[max(before, 0)]
    slope = (values[before + 1] - values[before]) / (places[before + 1] - places[before])
    return slope * (place - places[before]) + values[before]


def legs_of(path: tuple[Waypoint, ...]) -> tuple[Leg, ...]:
    """Splits a path at its turns on the spot."""
    runs: list[list[Waypoint]] = [[path[0]]]
    turns = [0.0]
    for before, pose in itertools.pairwise(path):
        if math.dist(before[:2], pose[:2]) > 1e-6:
            runs[-1].append(pose)
            continue
        if len(runs[-1]) > 1:
            runs.append([pose])
            turns.append(0.0)
        runs[-1] = [pose]
        turns[-1] += math.remainder(pose.yaw - before.yaw, 2 * math.pi)
    return tuple(_leg(run, turn) for run, turn in zip(runs, turns, strict=True) if len(run) > 1)


def _leg(run: list[Waypoint], turn_rad: float) -> Leg:
    poses = np.array(run)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1))])
    return Leg(poses[:, :2], along, np.unwrap(poses[:, 2]), turn_rad)


class Follower:
    """Controller that follows one path; call `act` once at each step.

    Args:
        path: path from the pose of the robot.
        robot: limits of speed and yaw rate.
        config: parameters of the pursuit.
        is_moving: whether the robot drives at the start of the path; a robot at rest first turns to the path, which is
            discretised to headings of 10 degrees, so a driving robot would stop for nothing.
    """

    def __init__(
        self, path: tuple[Waypoint, ...], robot: RobotConfig, config: PlannerConfig, *, is_moving: bool = False
    ) -> None:
        self._legs = legs_of(path)
        self._robot = robot
        self._config = config
        self._number = 0
        self._along_m = 0.0
        self._turning = not (is_moving and self._legs and self._legs[0].turn_rad == 0)

    @property
    def is_done(self) -> bool:
        """Whether the end of the path has been reached; the controller then drives straight on."""
        if not self._legs:
            return True
        return self._number == len(self._legs) - 1 and self._along_m >= self._legs[-1].length_m

    def act(self, pose: Pose, speed_limit_mps: float) -> Twist:
        """Returns the desired twist, with a speed of at least 0.

        Args:
            pose: pose of base_link.
            speed_limit_mps: speed limit of the caller, e.g. near the goal, m/s.
        """
        if not self._legs:
            return Twist(0.0, 0.0)
        leg = self._legs[self._number]
        self._along_m = leg.nearest(pose.x, pose.y, self._along_m)
        if leg.length_m - self._along_m < _LEG_END_M and self._number < len(self._legs) - 1:
            self._number, self._along_m, self._turning = self._number + 1, 0.0, True
            leg = self._legs[self._number]
        if self._turning:
            error = self._left_to_turn(leg, pose)
            self._turning = abs(error) > _ALIGNED_RAD
            if self._turning:
                return self._turn(error)
        aim_x, aim_y = leg.at(self._along_m + self._config.look_ahead_m)
        distance = math.hypot(aim_x - pose.x, aim_y - pose.y)
        error = math.remainder(math.atan2(aim_y - pose.y, aim_x - pose.x) - pose.yaw, 2 * math.pi)
        return self._turn(error) if abs(error) > _LOST_RAD else self._pursue(leg, error, distance, speed_limit_mps)

    def _left_to_turn(self, leg: Leg, pose: Pose) -> float:
        """Returns the angle from the robot's heading to the leg's first heading, radians.

        If the shorter direction is opposite to the planned turn and exceeds a right angle, the result is the angle in
        the planned direction: in the other direction, the tail could hit an obstacle.
        """
        error = math.remainder(float(leg.yaw[0]) - pose.yaw, 2 * math.pi)
        if error * leg.turn_rad < 0 and abs(error) > math.pi / 2:
            error += math.copysign(2 * math.pi, leg.turn_rad)  # the shorter direction may be blocked
        return error

    def _turn(self, error: float) -> Twist:
        rate = min(self._robot.max_yaw_rate_rps, math.sqrt(2 * _TURN_BRAKING_RPS2 * abs(error)))
        return Twist(0.0, math.copysign(rate, error))

    def _pursue(self, leg: Leg, error: float, distance: float, speed_limit_mps: float) -> Twist:
        curvature = 2 * math.sin(error) / max(distance, 1e-3)
        bend = max(abs(curvature), leg.curvature(self._along_m), 1e-6)
        speed = min(
            self._robot.max_speed_mps, speed_limit_mps, math.sqrt(self._config.lateral_acceleration_mps2 / bend)
        )
        if self._number < len(self._legs) - 1:
            left = max(0.0, leg.length_m - self._along_m - _LEG_END_M)
            speed = min(speed, math.sqrt(2 * _LEG_BRAKING_MPS2 * left))
        speed = max(speed, min(_SLOWEST_MPS, speed_limit_mps))
        limit = self._robot.max_yaw_rate_rps
        return Twist(speed, min(max(speed * curvature, -limit), limit))
