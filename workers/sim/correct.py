"""Episode that a policy drives, with the planner's action beside it: who acts in a step, and the labels.

The controller has the interface of an expert, so the loop of demonstrations runs it. It knows no policy: the caller
passes a driver. Stores no bundle.

Design: docs/training/corrections.md.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from schemas.bundle import Corrections
from schemas.config import CorrectionConfig
from schemas.errors import FactoryError, UsageError
from schemas.job import Job
from schemas.scene import Target
from schemas.support.numpy_types import Floats
from schemas.terms import Driver
from workers.experts import Expert, ExpertObservation
from workers.experts.observation import Observation
from workers.experts.planner import PlannerExpert
from workers.geometry.grid import Grid
from workers.geometry.pose import Pose
from workers.geometry.slew import Twist
from workers.planning import Waypoint

_STILL_MPS, _STILL_RPS = 0.02, 0.05
"""Measured speed, m/s, and yaw rate, rad/s, below which the robot stands still."""
_ARC_POINTS = 4
_PATH_MPS, _TURN_S, _SETTLE_S = 0.6, 0.2, 1.5
"""Estimates of the time that the planner needs: mean speed along its path, m/s; a turn on the spot by one heading, and
braking and standing at the end, seconds."""
_NO_LABEL = Twist(math.nan, math.nan)
_PUSH_S = 0.4
"""Time for which one random action is held, seconds."""


class PolicyError(Exception):
    """The policy failed in this episode: it raised, hung, or returned no valid action."""


class PolicyUnavailable(FactoryError):
    """The policy cannot be reached from this machine; no episode is at fault."""


class PolicyDriver(Protocol):
    """Policy that drives the episodes of this process."""

    def begin(self, job: Job, instruction: str) -> None:
        """Starts an episode.

        Raises:
            PolicyError: the policy failed.
        """

    def act(self, view: Observation, track: Floats) -> Sequence[Twist]:
        """Returns the next twists, at least one.

        Args:
            view: observation before the next step.
            track: (t + 1, 7) poses of base_link so far.

        Raises:
            PolicyError: the policy failed.
            PolicyUnavailable: the policy cannot be reached.
        """


class CorrectedPolicy:
    """Controller of one episode; implements `Expert`, after `begin` of the planner.

    Args:
        job: job with corrections.
        planner: planner whose `begin` found a path from the start.
        driver: policy, whose `begin` was called.
        grid: occupancy grid of the scene.
    """

    def __init__(self, job: Job, planner: PlannerExpert, driver: PolicyDriver, grid: Grid) -> None:
        assert job.correction is not None
        self._job, self._planner, self._driver, self._grid = job, planner, driver, grid
        self._config: CorrectionConfig = job.correction
        self._rng = job.correction_rng()
        self._hz = job.task.control_hz
        self._disturbed = self._steps(self._config.disturbance_s) * (self._rng.random() < self._config.disturbed_share)
        self._push = Twist(0.0, 0.0)
        self._poses: list[tuple[float, ...]] = []
        self._route: tuple[Waypoint, ...] = ()
        self._labels: list[Twist] = []
        self._drivers: list[Driver] = []
        self._queue: deque[Twist] = deque()
        self._wanted = Twist(0.0, 0.0)
        self._still = 0
        self._takeovers = 0
        self._expert_until = 0
        self._is_final = False
        self._by = Driver.POLICY

    def begin(self, start: Pose, grid: Grid, target: Target) -> tuple[Waypoint, ...] | None:
        """Prepares the planner again from another start."""
        return self._planner.begin(start, grid, target)

    def act(self, seen: ExpertObservation) -> Twist:
        """Returns the desired twist of this step's driver, and records the label of the planner.

        Raises:
            PolicyError: the policy failed.
        """
        assert isinstance(seen, Observation)
        pose, t = seen.pose, len(self._poses)
        speed_mps = self._move_to(pose)
        label = _NO_LABEL
        if t % self._config.label_steps == 0:
            path = self._planner.path_from(pose)
            if path is not None:
                self._route = self._route or path
                label = self._planner.action_on(path, seen, speed_mps)
            self._by = self._choose(seen, t, path, speed_mps)
        self._labels.append(label)
        self._drivers.append(self._by)
        self._wanted = self._act_by(seen, t)
        return self._wanted

    def corrections(self) -> Corrections:
        """Returns the labels and the drivers of the steps so far."""
        robot = self._job.robot
        labels = np.array(self._labels, np.float32).reshape(-1, 2)
        low = np.array((0.0, -robot.max_yaw_rate_rps), np.float32)
        high = np.array((robot.max_speed_mps, robot.max_yaw_rate_rps), np.float32)
        route = np.array([(point.x, point.y) for point in self._route])
        distances = _distances_to(route, np.array(self._poses)[:, :2]) if len(route) else np.zeros(len(labels))
        return Corrections(
            np.clip(labels, low, high), np.array(self._drivers, np.uint8), route_m=distances.astype(np.float32)
        )

    def _steps(self, seconds: float) -> int:
        return max(1, round(seconds * self._hz))

    def _move_to(self, pose: Pose) -> float:
        """Adds a pose to the track, and returns the measured speed, m/s."""
        before = self._poses[-1] if self._poses else None
        self._poses.append((pose.x, pose.y, pose.z, pose.qw, pose.qx, pose.qy, pose.qz))
        if before is None:
            self._yaw = pose.yaw
            return 0.0
        speed = math.dist(before[:2], self._poses[-1][:2]) * self._hz
        turned = abs(math.remainder(pose.yaw - self._yaw, 2 * math.pi)) * self._hz
        self._yaw = pose.yaw
        self._still = self._still + 1 if speed < _STILL_MPS and turned < _STILL_RPS else 0
        return speed

    def _choose(self, seen: Observation, t: int, path: tuple[Waypoint, ...] | None, speed_mps: float) -> Driver:
        """Returns who acts until the next label; the policy, if the planner has no path from here."""
        if t < self._disturbed:
            return Driver.DISTURBANCE
        if self._is_final or t < self._expert_until:
            return Driver.EXPERT
        if path is None:
            return Driver.POLICY
        if t + self._steps_to_go(path) >= self._job.task.max_steps:
            self._is_final = True
        elif self._is_stopped(seen) or self._hits(seen.pose):
            self._takeovers += 1
            self._is_final = self._takeovers > self._config.takeovers
            self._expert_until = t + self._steps(self._config.takeover_s)
        elif not self._rng.random() < self._config.expert_share:
            return Driver.POLICY
        self._planner.resume(path, speed_mps)
        self._queue.clear()
        self._still = 0
        return Driver.EXPERT

    def _steps_to_go(self, path: tuple[Waypoint, ...]) -> int:
        """Returns the steps that the planner needs for a path, by an estimate."""
        lengths = [math.dist(a[:2], b[:2]) for a, b in itertools.pairwise(path)]
        turns = sum(length < 1e-6 for length in lengths)
        return self._steps(sum(lengths) / _PATH_MPS + turns * _TURN_S + _SETTLE_S)

    def _is_stopped(self, seen: Observation) -> bool:
        """Returns whether the robot stands still outside the success region."""
        is_outside = seen.distance_m > self._job.task.success_radius_m
        return is_outside and self._still >= self._steps(self._config.standstill_s)

    def _hits(self, pose: Pose) -> bool:
        """Returns whether the last command would lead to a collision within the look-ahead time."""
        v, w = self._wanted
        if v <= 0:
            return False
        seconds = np.linspace(0.0, self._config.look_ahead_s, _ARC_POINTS + 1)
        yaw = pose.yaw + w * seconds / 2  # mean heading of the arc up to that time
        x, y = pose.x + v * seconds * np.cos(yaw), pose.y + v * seconds * np.sin(yaw)
        room = self._grid.room_at_poses(x, y, pose.yaw + w * seconds)
        return bool((room[1:] < min(0.0, float(room[0]) - self._grid.resolution_m / 2)).any())

    def _act_by(self, seen: Observation, t: int) -> Twist:
        if self._by is Driver.EXPERT:
            return self._planner.act(seen)
        if self._by is Driver.DISTURBANCE:
            if t % self._steps(_PUSH_S) == 0:
                robot = self._job.robot
                v, w = self._rng.uniform((0.0, -1.0), 1.0) * (robot.max_speed_mps, robot.max_yaw_rate_rps)
                self._push = Twist(float(v), float(w))
            return Twist(0.0, self._push.w_rps) if self._hits(seen.pose) else self._push
        if not self._queue:
            self._queue.extend(self._driver.act(seen, np.array(self._poses, np.float64)))
        return self._queue.popleft()


def begin_correction(
    job: Job, expert: Expert, driver: PolicyDriver | None, grid: Grid, instruction: str
) -> CorrectedPolicy:
    """Returns the controller of an episode with corrections, and starts the episode of its policy.

    Args:
        job: job with corrections.
        expert: planner whose `begin` found a path from the start.
        driver: policy of this process.
        grid: occupancy grid of the scene.
        instruction: instruction for the policy.

    Raises:
        PolicyError: the policy failed.
        UsageError: this process has no policy.
    """
    assert job.correction is not None
    assert isinstance(expert, PlannerExpert), "the plan of corrections has no false premises"
    if driver is None:
        raise UsageError(
            f"{job.episode_id} was driven by policy {job.correction.policy}, which this command does not run; "
            "`factory correct` does, and `factory worker --policy` on other hosts"
        )
    driver.begin(job, instruction)
    return CorrectedPolicy(job, expert, driver, grid)


def _distances_to(line: Floats, points: Floats) -> Floats:
    """Returns the distances (T,) from points (T, 2) to a line through K points (K, 2), metres."""
    first, along = line[:-1], np.diff(line, axis=0)
    if not len(along):
        return np.asarray(np.linalg.norm(points - line[0], axis=1))
    squared = np.maximum((along**2).sum(axis=1), 1e-12)
    share = np.clip(((points[:, None] - first) * along).sum(axis=2) / squared, 0.0, 1.0)
    nearest = first + share[..., None] * along
    return np.asarray(np.linalg.norm(points[:, None] - nearest, axis=2).min(axis=1))
