"""Pose of base_link in the world frame, as a value type. Imports no physics and no rendering."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Pose:
    """Pose of base_link (x forward, y left, z up) in the world frame, float64.

    The origin of base_link is on the floor midway between the drive wheels. The unit quaternion (w, x, y, z) rotates
    vectors from base_link to the world frame.
    """

    x: float
    """Metres."""
    y: float
    """Metres."""
    z: float
    """Metres."""
    qw: float = 1.0
    qx: float = 0.0
    qy: float = 0.0
    qz: float = 0.0

    @classmethod
    def planar(cls, x: float, y: float, yaw_rad: float, z: float = 0.0) -> Pose:
        """Returns an upright pose at (x, y, z) metres that heads `yaw_rad` from the world's x axis."""
        return cls(x, y, z, math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2))

    @classmethod
    def of(cls, row: NDArray[np.float64]) -> Pose:
        """Returns the pose of a row (7,) of recorded poses: x, y, z, qw, qx, qy, qz."""
        return cls(*map(float, row))

    def levelled(self, limit_rad: float) -> Pose:
        """Returns an upright pose with this position and heading if the tilt is at most `limit_rad`, else this pose."""
        if 2 * math.hypot(self.qx, self.qy) > limit_rad:
            return self
        scale = 1 / math.hypot(self.qw, self.qz)
        return Pose(self.x, self.y, z=self.z, qw=self.qw * scale, qx=0.0, qy=0.0, qz=self.qz * scale)

    @property
    def yaw(self) -> float:
        """Heading in radians, (-pi, pi], counter-clockwise from the world's x axis."""
        return math.atan2(2 * (self.qw * self.qz + self.qx * self.qy), 1 - 2 * (self.qy * self.qy + self.qz * self.qz))
