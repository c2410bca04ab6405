"""Rollout statistics computed again from the poses, and whether the episode ends in a true success. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coordinator.check_motion import yaw_of
from schemas.bundle import EpisodeArrays
from schemas.episode import EpisodeMeta
from schemas.terms import TIER_RANGE_M, EndReason
from schemas.tokens import tokens_of

__all__ = ["rollout_findings", "visibility_findings"]

DISTANCE_SLACK_M = 1e-3
"""Between a recorded distance and the one the float32 poses give; 1000 roundings at 50 m add up to less."""
POSE_SLACK = 1e-4
"""Metres and radians between the recorded spawn pose and pose 0."""
SPEED_SLACK_MPS = 1e-3
"""Between the speed the rollout measured and the one of the float32 poses: 4e-6 m at 50 m, times 60 Hz."""
RADIUS_SLACK_M = 1e-5
"""Between a distance in float64 and in float32 poses."""


def rollout_findings(meta: EpisodeMeta, arrays: EpisodeArrays) -> list[str]:
    """Returns all in which the recorded statistics differ from what the arrays say, and what denies the success."""
    poses = arrays.poses.astype(np.float64)
    goal = np.asarray(meta.target_centroid_m)
    distances = np.hypot(poses[:, 0] - goal[0], poses[:, 1] - goal[1])
    return [
        *_statistics_findings(meta, poses, distances),
        *_spawn_findings(meta, poses, float(distances[0])),
        *_success_findings(meta, poses, distances),
        *_token_findings(arrays),
    ]


def visibility_findings(meta: EpisodeMeta, target_pixels: Sequence[int]) -> list[str]:
    """Returns whether the recorded visibility differs from the id images.

    Args:
        meta: of the episode.
        target_pixels: pixels of the target in every frame.
    """
    least = meta.job.gains.min_mask_px
    visible = sum(pixels >= least for pixels in target_pixels)
    if visible == meta.rollout.steps_visible:
        return []
    found = f"{visible} frames show {least} or more pixels of the target"
    return [f"steps_visible {meta.rollout.steps_visible}, but {found}"]


def _statistics_findings(meta: EpisodeMeta, poses: NDArray[np.float64], distances: NDArray[np.float64]) -> list[str]:
    rollout, goal = meta.rollout, meta.target_centroid_m
    computed = {
        "spawn_dist_m": float(distances[0]),
        "trajectory_length_m": float(np.hypot(np.diff(poses[:, 0]), np.diff(poses[:, 1])).sum()),
        "final_ne_m": float(distances[-1]),
        "final_ne_3d_m": math.dist(poses[-1, :3].tolist(), goal),
        "min_ne_m": float(distances.min()),
    }
    found = [
        f"{name} {getattr(rollout, name):.6f}, the poses give {value:.6f} m"
        for name, value in computed.items()
        if not abs(getattr(rollout, name) - value) <= DISTANCE_SLACK_M
    ]
    counts = {"collision_count": rollout.collision_count, "steps_visible": rollout.steps_visible}
    found += [f"{name} {n} in {len(poses)} steps" for name, n in counts.items() if n > len(poses)]
    if len(poses) > meta.job.task.max_steps:
        found.append(f"num_steps {len(poses)} is more than the job's max_steps {meta.job.task.max_steps}")
    return found


def _spawn_findings(meta: EpisodeMeta, poses: NDArray[np.float64], distance: float) -> list[str]:
    x, y, yaw = meta.rollout.spawn_pose
    first_yaw = float(yaw_of(poses[:1])[0])
    off = math.dist((x, y), poses[0, :2].tolist())
    turned = abs(math.remainder(yaw - first_yaw, 2 * math.pi))
    found = []
    if not (off <= POSE_SLACK and turned <= POSE_SLACK):
        found.append(f"spawn_pose lies {off:.6f} m and {turned:.6f} rad from pose 0")
    if meta.rollout.spawn_draws > meta.job.spawn.physics_draws:
        found.append(f"spawn_draws {meta.rollout.spawn_draws}, the job allows {meta.job.spawn.physics_draws}")
    low, high = TIER_RANGE_M.get(meta.job.tier, (0.0, math.inf))
    slack = meta.job.spawn.max_displacement_m  # the warm-up may carry the robot so far from where it was drawn
    if not low - slack <= distance <= high + slack:
        found.append(f"spawn distance {distance:.3f} m is outside tier {meta.job.tier} ({low:g}-{high:g} m)")
    return found


def _success_findings(meta: EpisodeMeta, poses: NDArray[np.float64], distances: NDArray[np.float64]) -> list[str]:
    task = meta.job.task
    if meta.rollout.end_reason is not EndReason.SUCCESS:
        return [f"end_reason is {meta.rollout.end_reason}; only successes are archived"]
    if len(poses) <= task.hold_steps:
        return [f"{len(poses)} frames cannot hold a success of {task.hold_steps} stationary steps"]
    found = []
    farthest = float(distances[-task.hold_steps :].max())
    if not farthest <= task.success_radius_m + RADIUS_SLACK_M:
        found.append(f"no success: {farthest:.4f} m from the target in the hold, radius {task.success_radius_m:g} m")
    last = poses[-task.hold_steps - 1 :, :2]
    speed = float(np.hypot(*np.diff(last, axis=0).T).max()) * task.control_hz
    if not speed < task.stationary_speed_mps + SPEED_SLACK_MPS:
        found.append(f"no success: {speed:.4f} m/s in the hold, stationary is below {task.stationary_speed_mps:g} m/s")
    return found


def _token_findings(arrays: EpisodeArrays) -> list[str]:
    wrong = np.flatnonzero((tokens_of(arrays.actions_continuous) != arrays.actions_tokens).any(axis=1))
    if len(wrong) == 0:
        return []
    t = int(wrong[0])
    action, token = arrays.actions_continuous[t].tolist(), arrays.actions_tokens[t].tolist()
    return [f"actions_tokens: {token} is not the nearest grid point of {action} at step {t}; {len(wrong)} steps differ"]
