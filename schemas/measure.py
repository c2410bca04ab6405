"""Computes the measures of a trajectory from its poses: start, trajectory length, navigation error.

Rollout, validation and evaluation share these formulas. Pure functions without input or output.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.support import portable

__all__ = ["TrackMeasure", "measure_track", "target_in_view", "yaw_of"]


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
    """Navigation error with the height of the centroid, metres."""
    min_ne_m: float
    """Smallest distance to the target's centroid, metres."""


def yaw_of(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the headings (T,) of poses (T, 7) x, y, z, qw, qx, qy, qz, radians."""
    w, x, y, z = poses[:, 3:].T
    return portable.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def measure_track(poses: NDArray[np.float64], centroid_m: tuple[float, float, float]) -> TrackMeasure:
    """Returns the measures of a track of (T, 7) poses and a target's centroid, both in the world frame, metres."""
    track = poses[:, :3]
    to_goal = np.linalg.norm(track[:, :2] - np.asarray(centroid_m[:2]), axis=1)
    steps = np.linalg.norm(np.diff(track[:, :2], axis=0), axis=1)
    return TrackMeasure(
        spawn_pose=(float(track[0, 0]), float(track[0, 1]), float(yaw_of(poses[:1])[0])),
        spawn_dist_m=float(to_goal[0]),
        trajectory_length_m=float(steps.sum()),
        final_ne_m=float(to_goal[-1]),
        final_ne_3d_m=math.dist(track[-1].tolist(), centroid_m),
        min_ne_m=float(to_goal.min()),
    )


def target_in_view(ids: NDArray[np.uint16], instance_id: int, min_pixels: int) -> bool:
    """Returns whether a frame shows the target; the last frame of an episode tells whether it is in view on arrival.

    Args:
        ids: (H, W) instance ids of the frame.
        instance_id: id of the target.
        min_pixels: smallest mask of a visible target, pixels (`gains.min_mask_px` of the job).
    """
    return int(np.count_nonzero(ids == instance_id)) >= min_pixels
