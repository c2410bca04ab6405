"""Converts continuous actions to tokens of the 7 x 7 action grid, and tokens to actions. Pure functions.

Source: paper Sec. II-B; docs/design/task.md#actions-and-tokens.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

GRID_POINTS = 7
"""Number of grid points of each action dimension."""
V_GRID_MPS: NDArray[np.float64] = np.linspace(0.0, 1.0, GRID_POINTS)
"""Grid points of the speed, m/s; token 0 is zero speed."""
W_GRID_RPS: NDArray[np.float64] = np.linspace(-1.5, 1.5, GRID_POINTS)
"""Grid points of the yaw rate, rad/s; token 3 is zero yaw rate."""


def tokens_of(actions: NDArray[np.float32]) -> NDArray[np.int16]:
    """Returns the nearest grid point of each action.

    Args:
        actions: (T, 2), v in m/s and w in rad/s.

    Returns:
        (T, 2) tokens 0..6; actions outside the range are clipped to it.
    """
    scaled = np.stack([actions[:, 0] * 6.0, (actions[:, 1] + 1.5) * 2.0], axis=1, dtype=np.float64)
    return np.clip(np.rint(scaled), 0, GRID_POINTS - 1).astype(np.int16)


def actions_of(tokens: NDArray[np.int16]) -> NDArray[np.float32]:
    """Returns the grid point of each token: (T, 2) in m/s and rad/s."""
    return np.stack([V_GRID_MPS[tokens[:, 0]], W_GRID_RPS[tokens[:, 1]]], axis=1).astype(np.float32)
