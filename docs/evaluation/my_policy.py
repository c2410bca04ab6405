"""Example policy: a class with the methods `reset` and `act`. It needs no base class and no registration.

Run it from the folder that this file is in:  factory eval DIR --policy my_policy:TowardsOpenFloor
"""

import numpy as np


class TowardsOpenFloor:
    """Turns towards the side that is farther away, and drives while the way ahead is free."""

    def reset(self, instruction, info):  # noqa: ARG002
        """Called before each episode; `info` has the seed, the limits and the camera's field of view."""
        self.v_max, self.w_max = info.v_range_mps[1], info.w_range_rps[1]

    def act(self, observation):
        """Called 60 times per second of simulated time; returns v in m/s and w in rad/s."""
        depth = observation["depth"]  # (640, 640) metres, 0 where nothing was hit
        rows = depth[200:400]
        left, right = np.median(rows[:, :320]), np.median(rows[:, 320:])
        ahead = np.percentile(rows[:, 220:420], 5)
        return (0.5 * self.v_max if ahead > 0.8 else 0.0), np.clip(0.5 * (left - right), -self.w_max, self.w_max)
