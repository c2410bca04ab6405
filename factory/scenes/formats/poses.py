"""Transforms of the XML formats: poses of roll, pitch and yaw, and quaternions. Pure functions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from schemas.support import portable
from schemas.support.numpy_types import Floats


def numbers(text: str | None, default: Sequence[float]) -> list[float]:
    """Returns the numbers of a text separated by spaces, or the default for `None` and empty text.

    Raises:
        ValueError: the text does not have as many numbers as the default, or one of them is not finite.
    """
    words = (text or "").split()
    if not words:
        return list(default)
    values = [float(word) for word in words]
    if len(values) != len(default) or not np.isfinite(values).all():
        raise ValueError(f"{text!r} is not {len(default)} finite numbers")
    return values


def pose_matrix(xyz: Sequence[float], rpy: Sequence[float]) -> Floats:
    """Returns the transform (4, 4) of a pose: roll about x, then pitch about y, then yaw about z, radians."""
    (cr, cp, cy), (sr, sp, sy) = portable.cos(np.array(rpy)), portable.sin(np.array(rpy))
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    matrix[:3, 3] = xyz
    return matrix


def quaternion_matrix(wxyz: Sequence[float]) -> Floats:
    """Returns the transform (4, 4) of a quaternion (w, x, y, z), which is normalised.

    Raises:
        ValueError: the quaternion is zero or not finite.
    """
    w, x, y, z = np.array(wxyz, np.float64)
    norm = w * w + x * x + y * y + z * z
    if not np.isfinite(norm) or norm < 1e-12:
        raise ValueError(f"rotation {list(wxyz)} is not a quaternion")
    s = 2.0 / norm
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)],
    ]
    return matrix
