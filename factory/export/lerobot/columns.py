"""Computes the numeric columns of LeRobot from an episode: state, action, tokens, pose, time. Pure functions.

With a stride of n, an action is the mean of the n commands from its frame to the next exported frame; executed for
one step of the lower rate, it covers the same distance and angle. Tokens are the grid points nearest to the mean.
State and pose are those of the frame itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.support.geometry import planar_states
from schemas.tokens import tokens_of

ACTION_NAMES = ("v_mps", "w_rps")
TOKEN_NAMES = ("v", "w")
POSE_NAMES = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
REWARD, SUCCESS, DONE = "next.reward", "next.success", "next.done"
"""Names of the columns of the outcome, as in LeRobot (`lerobot.utils.constants`)."""
INTERVENTION = "intervention"
"""Name of the column of frames in which the planner acted, not the policy, as LeRobot's DAgger strategy writes it."""


@dataclass(frozen=True)
class FrameColumns:
    """Columns with one row per exported frame."""

    state: NDArray[np.float32]
    """(N, 5) wheel odometry: x, y and yaw in the frame of the first pose (x forward, y left, yaw unwrapped), then v
    and w as measured over the recorded step before the frame, 0 in the first frame."""
    action: NDArray[np.float32]
    """(N, 2) commanded v (m/s) and w (rad/s); mean of the commands until the next exported frame."""
    tokens: NDArray[np.int64]
    """(N, 2) nearest points of the 7 x 7 action grid."""
    pose: NDArray[np.float32]
    """(N, 7) x, y, z, qw, qx, qy, qz of base_link in the world frame."""
    timestamp: NDArray[np.float32]
    """(N,) time since the first frame, seconds."""
    frame_index: NDArray[np.int64]
    """(N,) index of the frame, 0 to N - 1."""


def kept_frames(steps: int, stride: int) -> range:
    return range(0, steps, stride)


def frame_columns(
    actions: NDArray[np.float32], poses: NDArray[np.float64], recorded_hz: int, stride: int
) -> FrameColumns:
    """Returns the columns of an episode.

    Args:
        actions: (T, 2) recorded actions.
        poses: (T, 7) recorded poses.
        recorded_hz: recorded frames per second.
        stride: stride n of the exported frames; a divisor of `recorded_hz`.
    """
    kept = np.asarray(kept_frames(len(actions), stride))
    action = _mean_of_windows(actions, stride) if stride > 1 else actions
    return FrameColumns(
        state=planar_states(poses, recorded_hz)[kept],
        action=action,
        tokens=tokens_of(action).astype(np.int64),
        pose=poses[kept].astype(np.float32),
        timestamp=(np.arange(len(kept)) / (recorded_hz // stride)).astype(np.float32),
        frame_index=np.arange(len(kept), dtype=np.int64),
    )


def outcome_columns(frames: int, *, is_success: bool) -> dict[str, NDArray[np.float32] | NDArray[np.bool_]]:
    """Returns the columns of the outcome, which each describe the result of the action of a frame.

    Args:
        frames: number N of exported frames, at least 1.
        is_success: whether the episode ended with success.

    Returns:
        Reward (N,) float32: 1 in the last frame of a success, else 0. Success (N,) bool: the same as a truth value.
        Done (N,) bool: true in the last frame.
    """
    is_last = np.arange(frames) == frames - 1
    succeeded = is_last & is_success
    return {REWARD: succeeded.astype(np.float32), SUCCESS: succeeded, DONE: is_last}


def _mean_of_windows(actions: NDArray[np.float32], stride: int) -> NDArray[np.float32]:
    starts = np.arange(0, len(actions), stride)
    sums = np.add.reduceat(actions.astype(np.float64), starts, axis=0)
    sizes = np.diff(np.append(starts, len(actions)))
    return (sums / sizes[:, None]).astype(np.float32)
