"""The numbers that poses alone give: trajectory length, navigation error, start. Pure; one place for the formulas.

The rollout writes them, the validator computes them again, evaluation compares them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.support import portable

__all__ = ["TrackMeasure", "measure_track", "yaw_of"]


class TrackMeasure(NamedTuple):
    """Measures of one track, planar unless said otherwise (paper Sec. V; docs/design/task.md#distances)."""

    spawn_pose: tuple[float, float, float]
    """x, y in metres and yaw in radians of the first pose."""
    spawn_dist_m: float
    trajectory_length_m: float
    final_ne_m: float
    final_ne_3d_m: float
    min_ne_m: float


def yaw_of(poses: NDArray[np.float32]) -> NDArray[np.float64]:
    """Returns the (T,) headings in radians of (T, 7) poses x, y, z, qw, qx, qy, qz."""
    w, x, y, z = poses[:, 3:].astype(np.float64).T
    return portable.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def measure_track(poses: NDArray[np.float32], centroid_m: tuple[float, float, float]) -> TrackMeasure:
    """Measures a track of (T, 7) poses against a target's centroid, both in the world frame."""
    track = poses[:, :3].astype(np.float64)
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
