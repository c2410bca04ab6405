"""What an action means when only every n-th frame is kept. Pure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["windowed_actions"]


def windowed_actions(actions: NDArray[np.float32], stride: int) -> NDArray[np.float32]:
    """Returns the mean command from each kept frame up to the next.

    Held until the next kept frame, it covers the ground and the turn that the commands in between did; the command of
    the kept frame alone would not, where the robot speeds up or brakes.

    Args:
        actions: (T, 2) v in m/s, w in rad/s, of every recorded step.
        stride: of so many frames the first is kept.

    Returns:
        (ceil(T / stride), 2); the actions themselves for stride 1.
    """
    if stride == 1:
        return actions
    starts = np.arange(0, len(actions), stride)
    sums = np.add.reduceat(actions.astype(np.float64), starts, axis=0)
    counts = np.diff(np.append(starts, len(actions)))
    return (sums / counts[:, None]).astype(np.float32)
