"""Polygons of geometric primitives: box, plane, sphere, cylinder, cone, capsule.

Polygons are centred, in local units, with outward winding. Pure functions.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from schemas.support import portable

Polygons = tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]
"""Points (N, 3), corners of each face (F,), vertex of each corner (C,)."""

_SIDES = 24
_STEPS_PER_QUARTER = 6
_CUBE = [0, 3, 2, 1, 4, 5, 6, 7, 0, 1, 5, 4, 1, 2, 6, 5, 2, 3, 7, 6, 3, 0, 4, 7]
_TURN = {"X": [2, 0, 1], "Y": [1, 2, 0], "Z": [0, 1, 2]}


def box(half_x: float, half_y: float, half_z: float) -> Polygons:
    square = [(-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y)]
    points = np.array([(x, y, z) for z in (-half_z, half_z) for x, y in square])
    return points, np.full(6, 4), np.array(_CUBE)


def plane(half_x: float, half_y: float) -> Polygons:
    """Returns a rectangle of given half lengths in the plane z = 0 that faces up."""
    w, h = half_x, half_y
    points = np.array([(-w, -h, 0.0), (w, -h, 0.0), (w, h, 0.0), (-w, h, 0.0)])
    return points, np.array([4]), np.arange(4)


def sphere(radius: float) -> Polygons:
    return _lathe(_arc(radius, 0.0, -math.pi / 2, math.pi / 2))


def cylinder(bottom: float, top: float, half_height: float) -> Polygons:
    """Returns a cylinder along z with the radii `bottom` and `top`; a cone if `top` is 0."""
    return _lathe([(bottom, -half_height), (top, half_height)])


def capsule(bottom: float, top: float, half_height: float) -> Polygons:
    """Returns a cylinder along z with half spheres on both ends; `half_height` is that of the cylinder alone."""
    return _lathe(_arc(bottom, -half_height, -math.pi / 2, 0.0) + _arc(top, half_height, 0.0, math.pi / 2))


def turned(polygons: Polygons, axis: str) -> Polygons:
    """Returns polygons with their z axis along X, Y or Z."""
    points, counts, indices = polygons
    return points[:, _TURN[axis]], counts, indices


def _arc(radius: float, height: float, first: float, last: float) -> list[tuple[float, float]]:
    angles = np.linspace(first, last, 1 + round((last - first) / (math.pi / 2) * _STEPS_PER_QUARTER))
    return [(radius * math.cos(angle), height + radius * math.sin(angle)) for angle in angles]


def _lathe(profile: list[tuple[float, float]]) -> Polygons:
    """Revolves a profile about z and closes both ends."""
    angle = 2 * np.pi * np.arange(_SIDES) / _SIDES
    x, y = portable.cos(angle), portable.sin(angle)
    rings = [np.stack([r * x, r * y, np.full(_SIDES, z)], axis=1) for r, z in profile]
    side = np.arange(_SIDES)
    following = (side + 1) % _SIDES
    quads = [
        np.stack([row + side, row + following, row + _SIDES + following, row + _SIDES + side], axis=1)
        for row in range(0, _SIDES * (len(profile) - 1), _SIDES)
    ]
    caps = [side[::-1], side + _SIDES * (len(profile) - 1)]
    counts = np.array([4] * (_SIDES * (len(profile) - 1)) + [_SIDES, _SIDES])
    return np.concatenate(rings), counts, np.concatenate([np.concatenate(quads).ravel(), *caps])
