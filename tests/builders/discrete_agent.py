"""Agent of VLN-CE as a point that moves exactly by its actions, without collisions."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np


def execute(actions: Sequence[int], place: Sequence[float], yaw: float) -> tuple[np.ndarray, float]:
    """Returns the places (N, 2) of the agent, metres, and its last heading, radians.

    Args:
        actions: 0 stop, 1 forward 0.25 m, 2 left 15 degrees, 3 right 15 degrees.
        place: start x, y (x forward, y left), metres.
        yaw: start heading, radians.
    """
    x, y = place
    track = [(x, y)]
    for action in actions:
        if action == 1:
            x, y = x + 0.25 * math.cos(yaw), y + 0.25 * math.sin(yaw)
            track.append((x, y))
        elif action in (2, 3):
            yaw += math.radians(15.0 if action == 2 else -15.0)
        else:
            assert action == 0, f"unknown action {action}"
            break
    return np.array(track), yaw
