"""Computes the training labels of a frame: the twist to hold, and whether to stop. Pure functions over arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_TAIL_STEPS, _TAIL_STRIDE = 30, 2
"""Length and stride of the denser sampling at the end of an episode, steps. The stop takes about half a second."""


class Labels(NamedTuple):
    """Labels of the selected frames, one row each."""

    actions: NDArray[np.float32]
    """(N, 2) v in m/s and w in rad/s to hold until the next selected frame; (0, 0) for a stop."""
    is_stop: NDArray[np.bool_]
    """(N,) whether the expert stops from this frame on."""


def stop_frame(actions: NDArray[np.float32], max_braking_mps2: float, control_hz: int) -> int:
    """Returns the first frame of the final full braking, or the number of frames if there is none.

    The recorded commands are slew limited: the expert's decision to stop appears as a speed that decreases at the
    braking limit to 0 and remains there. A speed that the expert reduces with the distance to the target falls
    ten times more slowly.

    Args:
        actions: (T, 2) recorded commands.
        max_braking_mps2: Slew limit of braking, m/s2.
        control_hz: Control rate, Hz.
    """
    speed = actions[:, 0].astype(np.float64)
    if not len(speed) or speed[-1] > 0:
        return len(speed)
    least = 0.5 * max_braking_mps2 / control_hz
    before = np.concatenate([speed[:1], speed[:-1]])
    braking = (speed == 0) | (before - speed >= least)
    others = np.flatnonzero(~braking)
    return int(others[-1]) + 1 if len(others) else 0


def chosen_frames(steps: int, stride: int) -> NDArray[np.int64]:
    """Returns the indices of the training frames: every `stride`-th frame, and more in the last half second."""
    tail = range(max(0, steps - _TAIL_STEPS), steps, _TAIL_STRIDE)
    return np.array(sorted({*range(0, steps, stride), *tail}), np.int64)


def label_episode(actions: NDArray[np.float32], frames: NDArray[np.int64], stop: int, hold: int) -> Labels:
    """Returns the labels of the selected frames.

    The twist of a frame is the command at the end of its hold time, or at the last frame before the stop if that is
    earlier. The end is used because the first commands of an episode only reflect the acceleration limit.

    Args:
        actions: (T, 2) recorded commands.
        frames: (N,) selected frames.
        stop: First frame of the stop.
        hold: Steps for which an action is held.
    """
    is_stop = frames >= stop
    last = np.minimum(frames + hold - 1, max(0, min(stop, len(actions)) - 1))
    wanted = actions[np.where(is_stop, frames, last)].astype(np.float32)
    wanted[is_stop] = 0.0
    return Labels(wanted, is_stop)
