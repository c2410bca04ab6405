"""What the network is to answer at a frame: the twist to hold, and whether to stand. Pure; arrays in, arrays out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Labels", "chosen_frames", "label_episode", "stop_frame"]

_TAIL_STEPS, _TAIL_STRIDE = 30, 2
"""The end of an episode is looked at more often: the stop is decided in half a second of ten."""


class Labels(NamedTuple):
    """One row a chosen frame."""

    actions: NDArray[np.float32]
    """(N, 2) v in m/s and w in rad/s to hold until the next look; (0, 0) where the robot is to stand."""
    is_stop: NDArray[np.bool_]
    """(N,) whether the expert wants to stand from this frame on."""


def stop_frame(actions: NDArray[np.float32], max_braking_mps2: float, control_hz: int) -> int:
    """Returns the first frame whose action belongs to the last full braking; the length when there is none.

    The recorded commands have passed the slew limit: the expert's decision to stand shows as a speed that falls at
    the limit down to 0 and stays there. A speed that sinks with the distance falls ten times slower.

    Args:
        actions: (T, 2) as recorded.
        max_braking_mps2: the slew limit of braking, m/s2.
        control_hz: steps a second.
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
    """Returns the frames that are learned from: every `stride`-th, and more of the last half second."""
    tail = range(max(0, steps - _TAIL_STEPS), steps, _TAIL_STRIDE)
    return np.array(sorted({*range(0, steps, stride), *tail}), np.int64)


def label_episode(actions: NDArray[np.float32], frames: NDArray[np.int64], stop: int, hold: int) -> Labels:
    """Returns the labels of the chosen frames.

    The twist of a frame is the command at the end of the time it will be held for, not beyond the frame before the
    stop: at the end, because the first commands of an episode say only that a robot cannot start at once.

    Args:
        actions: (T, 2) as recorded.
        frames: (N,) chosen frames.
        stop: the first frame to stand at.
        hold: steps for which an action is held.
    """
    is_stop = frames >= stop
    last = np.minimum(frames + hold - 1, max(0, min(stop, len(actions)) - 1))
    wanted = actions[np.where(is_stop, frames, last)].astype(np.float32)
    wanted[is_stop] = 0.0
    return Labels(wanted, is_stop)
