"""Distances to the target: the goal region of an episode, and the measures of a trajectory from its poses.

Rollout, validation, statistics and evaluation share these formulas. Pure functions without input or output. They
ignore obstacles, and do not decide when an episode ends.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from schemas.config import TaskConfig
from schemas.episode import EpisodeMeta
from schemas.episode_spec import EpisodeSpec
from schemas.errors import WorldError
from schemas.scene import Target
from schemas.support.approach import approach, ring, target_distances
from schemas.support.geometry import footprint_distances, gaps_to, planar_states, yaw_of
from schemas.support.numpy_types import Floats
from schemas.terms import SuccessMeasure

_OUTLINE_POINTS = 97
_FLAT = 0.02
"""Largest difference of the depths of one flat surface, as a share of the largest depth."""


STOPPED_RPS = 0.05
"""Largest commanded yaw rate of a robot that has stopped because of a false premise, rad/s."""


def hold_steps_of(spec: EpisodeSpec, task: TaskConfig) -> int:
    """Returns the number of stationary steps that make a success. With a false premise, it is at least the number of
    steps in one second, because a robot that is about to drive is stationary for a few steps, too."""
    # Design: docs/design/language.md#success-of-a-false-premise.
    return max(task.hold_steps, task.control_hz) if spec.is_false_premise else task.hold_steps


@dataclass(frozen=True)
class Goal:
    """Points at most `radius_m` from a target's footprint or, without footprint, from its centroid."""

    centre_m: tuple[float, float]
    """x, y of the target's centroid, metres; it is inside the footprint."""
    radius_m: float
    """Success radius, metres."""
    footprint_m: tuple[tuple[float, float], ...] = ()
    """Vertices of the convex footprint, counter-clockwise, metres; if it is empty, distances are measured from the
    centroid."""

    @classmethod
    def of(cls, target: Target, task: TaskConfig) -> Self:
        """Returns the goal of a target.

        Raises:
            WorldError: the task measures to the footprint, and the scene records none.
        """
        return cls._of(target.centroid_m, target.footprint_m, task, target.target_id)

    @classmethod
    def of_episode(cls, meta: EpisodeMeta) -> Self:
        """Returns the goal of a recorded episode.

        Raises:
            WorldError: the task measures to the footprint, and the episode records none.
        """
        return cls._of(meta.target_centroid_m, meta.target_footprint_m, meta.job.task, meta.job.target_id)

    @classmethod
    def _of(
        cls,
        centroid_m: tuple[float, float, float],
        footprint_m: tuple[tuple[float, float], ...],
        task: TaskConfig,
        name: str,
    ) -> Self:
        by_surface = task.success is SuccessMeasure.SURFACE
        if by_surface and not footprint_m:
            raise WorldError(
                f'target {name} has no footprint, which task.success = "surface" needs; create the scene again with '
                '`factory scene build` or `factory scene import`, or set task.success = "centroid"'
            )
        return cls(centroid_m[:2], task.success_radius_m, footprint_m if by_surface else ())

    def shrunk(self, margin_m: float) -> Self:
        """Returns the part of the goal that is at least `margin_m` inside its edge."""
        return replace(self, radius_m=self.radius_m - margin_m)

    def distances(self, points: ArrayLike) -> Floats:
        """Returns the distances (...) of points (..., 2) to the target by the success measure, metres."""
        return target_distances(np.asarray(points, float), self._centre, self._vertices)

    def distance(self, x: float, y: float) -> float:
        """Returns the distance of one point to the target by the success measure, metres."""
        if self.footprint_m:
            return float(footprint_distances((x, y), self.footprint_m))
        return math.hypot(self.centre_m[0] - x, self.centre_m[1] - y)

    def is_disjoint(self, other: Goal) -> bool:
        if self.footprint_m and other.footprint_m:
            gap = min(self._least_gap(other.footprint_m), other._least_gap(self.footprint_m))
        else:
            gap = math.dist(self.centre_m, other.centre_m)
        return gap > self.radius_m + other.radius_m

    def _least_gap(self, points: ArrayLike) -> float:
        return float(footprint_distances(points, self.footprint_m).min())

    def approach(self, starts: ArrayLike, distance_m: ArrayLike) -> Floats:
        """Returns the points (..., 2) at which straight lines from starts to the centroid come within a distance.

        Returns a start itself if it is within that distance.

        Args:
            starts: (..., 2) points, metres.
            distance_m: one distance by the success measure, or one for each start (...), metres.
        """
        limit = np.asarray(distance_m, float)
        return approach(np.asarray(starts, float), limit, self._centre, self._vertices)

    def entry(self, point: Floats) -> tuple[float, Floats]:
        """Returns length and end of the shortest line from a point (2,) to the goal; the length is at most 0 for a
        point in the goal."""
        if not self.footprint_m:
            gap = math.dist(point, self.centre_m) - self.radius_m
            return gap, point + (self._centre - point) * (gap / (gap + self.radius_m))
        distance = self.distance(point[0], point[1])
        gap = distance - self.radius_m
        return gap, point + gaps_to(point, np.asarray(self.footprint_m)) * (gap / max(distance, 1e-9))

    def ring(self, directions: Floats, distance_m: ArrayLike) -> Floats:
        """Returns the points (N, 2) at given distances from the target, on rays from its centroid.

        Args:
            directions: (N, 2) unit vectors.
            distance_m: one distance by the success measure, or one for each direction (N,), metres.
        """
        distance = np.asarray(distance_m, float)
        return ring(directions, distance, self._centre, np.asarray(self.extent_m), self._vertices)

    def outline(self) -> Floats:
        """Returns the edge of the goal as a closed line (N, 2), for drawing."""
        angle = np.linspace(0.0, 2 * math.pi, _OUTLINE_POINTS)
        return self.ring(np.stack([np.cos(angle), np.sin(angle)], axis=1), self.radius_m)

    @cached_property
    def extent_m(self) -> float:
        """Largest distance of a point of the footprint from the centroid, metres; 0 without footprint."""
        return max((math.dist(vertex, self.centre_m) for vertex in self.footprint_m), default=0.0)

    @cached_property
    def _centre(self) -> Floats:
        return np.asarray(self.centre_m, float)

    @cached_property
    def _vertices(self) -> Floats | None:
        return np.asarray(self.footprint_m, float) if self.footprint_m else None


class TrackMeasure(NamedTuple):
    """Measures of one trajectory, planar except for `final_ne_3d_m` (paper Sec. V; docs/design/task.md#distances)."""

    spawn_pose: tuple[float, float, float]
    """x, y in metres and yaw in radians of the first pose."""
    spawn_dist_m: float
    """Distance from the first pose to the target's centroid, metres."""
    trajectory_length_m: float
    """Trajectory length (TL): sum of distances between consecutive poses, metres."""
    final_ne_m: float
    """Navigation error (NE): distance from the last pose to the target's centroid, metres."""
    final_ne_3d_m: float
    """Navigation error in three dimensions: distance to the target's centroid, metres."""
    min_ne_m: float
    """Smallest distance to the target's centroid, metres."""
    spawn_surface_m: float | None
    """Distance from the first pose to the target's footprint, metres; `None` without footprint."""
    final_surface_m: float | None
    """Distance from the last pose to the target's footprint, metres; `None` without footprint."""


def measure_track(
    poses: NDArray[np.float64],
    centroid_m: tuple[float, float, float],
    footprint_m: Sequence[tuple[float, float]] = (),
) -> TrackMeasure:
    """Returns the measures of a track.

    Args:
        poses: (T, 7) poses of base_link in the world frame.
        centroid_m: centroid of the target in the world frame, metres.
        footprint_m: vertices of the target's convex footprint, counter-clockwise, metres; empty if it is unknown.
    """
    track = poses[:, :3]
    to_goal = np.linalg.norm(track[:, :2] - np.asarray(centroid_m[:2]), axis=1)
    steps = np.linalg.norm(np.diff(track[:, :2], axis=0), axis=1)
    surface = footprint_distances(track[[0, -1], :2], footprint_m).tolist() if footprint_m else (None, None)
    return TrackMeasure(
        spawn_pose=(float(track[0, 0]), float(track[0, 1]), float(yaw_of(poses[:1])[0])),
        spawn_dist_m=float(to_goal[0]),
        trajectory_length_m=float(steps.sum()),
        final_ne_m=float(to_goal[-1]),
        final_ne_3d_m=math.dist(track[-1].tolist(), centroid_m),
        min_ne_m=float(to_goal.min()),
        spawn_surface_m=surface[0],
        final_surface_m=surface[1],
    )


def target_in_view(ids: NDArray[np.uint16], instance_id: int, min_pixels: int) -> bool:
    """Returns whether a frame shows the target with enough pixels.

    Args:
        ids: (H, W) instance ids of the frame.
        instance_id: id of the target.
        min_pixels: smallest mask of a visible target, pixels (`gains.min_mask_px` of the job).
    """
    return int(np.count_nonzero(ids == instance_id)) >= min_pixels


def shows_nothing(depth: NDArray[np.float32], ids: NDArray[np.uint16]) -> bool:
    """Returns whether a frame is one flat surface or empty: a single id, and depths that differ by at most 2 %.

    Args:
        depth: (H, W) metres along the optical axis; 0 where no surface was hit.
        ids: (H, W) instance ids.
    """
    nearest, farthest = float(depth.min()), float(depth.max())
    return farthest - nearest <= _FLAT * farthest and bool((ids == ids[0, 0]).all())


SURE_M = 0.05
"""Distance of the predicted rest from the edge of the success region below which both answers are right, metres: about
the error of the prediction."""


class StopLabel(IntEnum):
    """When to stop: it agrees with the success of a stop, not with the habit of an expert, which drives on until the
    target is ahead or its path ends. Design: docs/training/corrections.md#when-to-stop."""

    DRIVE = 0  # a stop would be outside the success region
    STOP = 1  # a stop succeeds, and the camera faces the target
    EITHER = 2  # both are right: a stop succeeds narrowly, or the camera does not face the target


def goal_bearings(goal: Goal, poses: Floats) -> Floats:
    """Returns the angles (T,) from the robot's heading to the target's centroid, counter-clockwise, in [-pi, pi].

    Args:
        goal: goal of the episode.
        poses: (T, 7) poses of base_link in the world frame.
    """
    to_target = np.asarray(goal.centre_m) - poses[:, :2]
    angles = np.arctan2(to_target[:, 1], to_target[:, 0]) - yaw_of(poses)
    return np.asarray(np.remainder(angles + math.pi, 2 * math.pi) - math.pi)


def stop_labels(meta: EpisodeMeta, poses: Floats) -> NDArray[np.uint8]:
    """Returns the label (T,) of each step, as `StopLabel` numbers them.

    The rest after full braking is predicted from the measured speed v: v^2 / (2 a) ahead.

    Args:
        meta: metadata of the episode: its goal, robot, camera and rate.
        poses: (T, 7) poses of base_link in the world frame.

    Raises:
        WorldError: the task measures to the footprint, and the episode records none.
    """
    job = meta.job
    if job.is_false_premise:  # the goal is to stand at the start
        return np.full(len(poses), StopLabel.STOP, np.uint8)
    goal, yaw = Goal.of_episode(meta), yaw_of(poses)
    speed = np.maximum(planar_states(poses, job.task.control_hz)[:, 3].astype(np.float64), 0.0)
    ahead = speed**2 / (2 * job.robot.max_braking_mps2)
    rest = poses[:, :2] + ahead[:, None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    left = goal.distances(rest) - goal.radius_m
    bearing = goal_bearings(goal, poses)
    is_sure = (left <= -SURE_M) & (np.abs(bearing) <= math.radians(job.camera.fov_deg) / 2)
    labels = np.where(left > 0, StopLabel.DRIVE, np.where(is_sure, StopLabel.STOP, StopLabel.EITHER))
    return labels.astype(np.uint8)
