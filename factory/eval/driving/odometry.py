"""Headings of a track, and where its last pose is as seen from the first. Pure."""

from __future__ import annotations

import math

import numpy as np

from schemas.support.numpy_types import Floats

__all__ = ["odometry", "yaws_of"]


def yaws_of(track: Floats) -> Floats:
    """Returns the headings (frames,) in radians of a (frames, 7) track x, y, z, qw, qx, qy, qz."""
    w, x, y, z = track[:, 3:].T
    return np.asarray(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


def odometry(track: Floats) -> Floats:
    """Returns the last pose of a (frames, 7) track in the frame of its first: x, y in metres and yaw in radians."""
    yaws = yaws_of(track[[0, -1]])
    dx, dy = track[-1, :2] - track[0, :2]
    cos, sin = math.cos(yaws[0]), math.sin(yaws[0])
    turn = math.remainder(float(yaws[1] - yaws[0]), 2 * math.pi)
    return np.array((cos * dx + sin * dy, cos * dy - sin * dx, turn))
