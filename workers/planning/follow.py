"""Pure pursuit along a planned path: leg by leg, turning on the spot between legs, slower in bends and towards ends.

Pure of any simulation; it never decides that the goal is reached, and never drives backwards.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from schemas.config import PlannerConfig, RobotConfig
from schemas.support.numpy_types import Floats
from workers.geometry.pose import Pose
from workers.geometry.slew import Twist
from workers.planning.lattice import Waypoint

__all__ = ["Follower", "Leg", "legs_of"]

_ALIGNED_RAD, _LOST_RAD = 0.10, 0.9
"""Heading error up to which a turn on the spot is done, and from which on driving is given up for one."""
_LEG_END_M = 0.04
_SLOWEST_MPS = 0.15
"""Slower driving could not be told from a stall."""
_LEG_BRAKING_MPS2, _TURN_BRAKING_RPS2 = 0.8, 1.8
"""Decelerations that speed and yaw rate are planned with, well below the slew limits."""
_PREVIEW_M = 0.6
"""Way ahead whose bends limit the speed."""
_REACH_M = 0.5
"""How far along the leg the nearest point may lie from the one before."""


@dataclass(frozen=True, eq=False)
class Leg:
    """A part of the path without a turn on the spot."""

    points: Floats
    """(N, 2) world x, y, metres."""
    along: Floats
    """(N,) length from the leg's start, metres."""
    yaw: Floats
    """(N,) heading, radians, unwrapped."""
    turn_rad: float
    """Turn on the spot before the leg, counter-clockwise positive; the way round that is known to be free."""

    @property
    def length_m(self) -> float:
        """From the first point to the last."""
        return float(self.along[-1])

    def at(self, along_m: float) -> tuple[float, float]:
        """Returns the point so far along the leg, straight on beyond its end."""
        beyond = max(0.0, along_m - self.length_m)
        x, y = (float(np.interp(along_m, self.along, column)) for column in self.points.T)
        yaw = float(self.yaw[-1])
        return x + beyond * math.cos(yaw), y + beyond * math.sin(yaw)

    def curvature(self, along_m: float) -> float:
        """Returns the mean curvature over the preview from there on, 1/m."""
        turned = np.interp([along_m, along_m + _PREVIEW_M], self.along, self.yaw)
        return abs(float(turned[1] - turned[0])) / _PREVIEW_M

    def nearest(self, x: float, y: float, from_m: float) -> float:
        """Returns how far along the leg the point nearest to (x, y) lies, not before `from_m`."""
        candidates = np.linspace(from_m, min(from_m + _REACH_M, self.length_m), 26)
        px, py = (np.interp(candidates, self.along, column) for column in self.points.T)
        return float(candidates[int(np.argmin((px - x) ** 2 + (py - y) ** 2))])


def legs_of(path: tuple[Waypoint, ...]) -> tuple[Leg, ...]:
    """Cuts a path where it turns on the spot."""
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
    """Follows one path, a call a step, in order."""

    def __init__(self, path: tuple[Waypoint, ...], robot: RobotConfig, config: PlannerConfig) -> None:
        self._legs = legs_of(path)
        self._robot = robot
        self._config = config
        self._number = 0
        self._along_m = 0.0
        self._turning = True

    @property
    def is_done(self) -> bool:
        """Whether the end of the path has been reached; from there on the way goes straight on."""
        if not self._legs:
            return True
        return self._number == len(self._legs) - 1 and self._along_m >= self._legs[-1].length_m

    def act(self, pose: Pose, speed_limit_mps: float) -> Twist:
        """Returns the wanted twist, forward only.

        Args:
            pose: of base_link.
            speed_limit_mps: what the caller allows, e.g. near the goal.
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
        """Angle to the leg's first heading, and no farther: beyond it the tail may not be free."""
        error = math.remainder(float(leg.yaw[0]) - pose.yaw, 2 * math.pi)
        if error * leg.turn_rad < 0 and abs(error) > math.pi / 2:
            error += math.copysign(2 * math.pi, leg.turn_rad)  # the short way round may be blocked
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
