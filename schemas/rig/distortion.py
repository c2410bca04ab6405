"""Lens distortion: the Brown-Conrady model of pinhole cameras and the equidistant model of fisheye cameras.

Pure functions in float64 with the conventions of OpenCV (`cv2.projectPoints`, `cv2.fisheye.distortPoints`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from schemas.support.numpy_types import Floats

_STEPS = 24
_NEWTON_STEPS = 6
_LEAST_GAIN = 1e-3
"""Smallest determinant of the Jacobian at which `undistort` returns a point. Where the determinant is 0, the distorted
image folds over."""


def distort(points: Floats, coefficients: Sequence[float]) -> Floats:
    """Returns distorted points (..., 2) of points (..., 2) on the plane z = 1.

    D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37(8), 1971; the coefficients are k1, k2,
    p1, p2, k3 in OpenCV's order.
    """
    k1, k2, p1, p2, k3 = coefficients
    x, y = points[..., 0], points[..., 1]
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    across = 2 * p1 * x * y + p2 * (square + 2 * x * x)
    down = p1 * (square + 2 * y * y) + 2 * p2 * x * y
    return np.stack((x * radial + across, y * radial + down), axis=-1)


def _derivative(points: Floats, coefficients: Sequence[float]) -> tuple[Floats, Floats, Floats]:
    """Returns dx'/dx, dx'/dy (equal to dy'/dx) and dy'/dy of `distort` at points (..., 2)."""
    k1, k2, p1, p2, k3 = coefficients
    x, y = points[..., 0], points[..., 1]
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    slope = 2 * (k1 + square * (2 * k2 + square * 3 * k3))
    mixed = x * y * slope + 2 * p1 * x + 2 * p2 * y
    return radial + x * x * slope + 2 * p1 * y + 6 * p2 * x, mixed, radial + y * y * slope + 6 * p1 * y + 2 * p2 * x


def undistort(points: Floats, coefficients: Sequence[float]) -> Floats:
    """Returns the points (..., 2) on the plane z = 1 whose distorted points are given; NaN where there is none.

    Follows the line from the centre to each point, with Newton's method, so the result is on the same side of a
    fold of the distortion as the centre.
    """
    plain = np.zeros_like(points)
    whole = np.ones(points.shape[:-1], bool)
    for share in np.linspace(0, 1, _STEPS + 1)[1:]:
        for _ in range(_NEWTON_STEPS if share == 1 else 2):
            error = distort(plain, coefficients) - share * points
            a, b, d = _derivative(plain, coefficients)
            gain = a * d - b * b
            whole &= (gain > _LEAST_GAIN) & (a + d > 0)
            safe = np.where(whole, gain, 1.0)
            plain = plain - np.stack(
                ((d * error[..., 0] - b * error[..., 1]) / safe, (a * error[..., 1] - b * error[..., 0]) / safe),
                axis=-1,
            )
            plain[~whole] = 0.0
    whole &= np.abs(distort(plain, coefficients) - points).max(axis=-1) < 1e-9 * (1 + np.abs(points).max(axis=-1))
    return np.where(whole[..., None], plain, np.nan)


def fisheye_radii(angles: Floats, coefficients: Sequence[float]) -> Floats:
    """Returns the image radii, in focal lengths, of rays at angles (...) from the optical axis, radians.

    J. Kannala and S. S. Brandt, "A generic camera model and calibration method for conventional, wide-angle, and
    fish-eye lenses", IEEE TPAMI 28(8), 2006; the coefficients are k1 to k4 of `cv2.fisheye`.
    """
    square = angles * angles
    k1, k2, k3, k4 = coefficients
    return np.asarray(angles * (1 + square * (k1 + square * (k2 + square * (k3 + square * k4)))))


def _radius_slope(angles: Floats, coefficients: Sequence[float]) -> Floats:
    square = angles * angles
    k1, k2, k3, k4 = coefficients
    return np.asarray(1 + square * (3 * k1 + square * (5 * k2 + square * (7 * k3 + square * 9 * k4))))


def first_fold(limit: float, coefficients: Sequence[float]) -> float | None:
    """Returns the smallest angle up to `limit`, radians, from which `fisheye_radii` no longer grows, or `None`."""
    angles = np.linspace(0, limit, 2000)
    folded = np.flatnonzero(_radius_slope(angles, coefficients) <= _LEAST_GAIN)
    return float(angles[folded[0]]) if len(folded) else None


def fisheye_angles(radii: Floats, limit: float, coefficients: Sequence[float]) -> Floats:
    """Returns the angles (...), radians, of image radii (...) in focal lengths; NaN beyond the angle `limit`.

    Below this angle the radius must increase, see `first_fold`.
    """
    table = np.linspace(0, limit, 512)
    edge = float(fisheye_radii(np.array(limit), coefficients))
    angles = np.interp(radii, fisheye_radii(table, coefficients), table)
    for _ in range(_NEWTON_STEPS):
        step = (fisheye_radii(angles, coefficients) - radii) / _radius_slope(angles, coefficients)
        angles = np.clip(angles - step, 0, limit)
    return np.where(radii <= edge * (1 + 1e-12), angles, np.nan)
