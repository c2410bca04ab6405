"""Converts the geometric primitives of USD to polygons: cube, sphere, cylinder, cone, capsule, plane.

Polygons are in local units with outward winding. Does not transform them and does not read materials.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import UsdGeom

from schemas.support import portable

Polygons = tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]
"""Points (N, 3), corners of each face (F,), vertex of each corner (C,)."""

_SIDES = 24
_STEPS_PER_QUARTER = 6
_CUBE = [0, 3, 2, 1, 4, 5, 6, 7, 0, 1, 5, 4, 1, 2, 6, 5, 2, 3, 7, 6, 3, 0, 4, 7]
_TURN = {"X": [2, 0, 1], "Y": [1, 2, 0], "Z": [0, 1, 2]}


def solid_polygons(prim: Any) -> Polygons | None:
    """Returns the polygons of a geometric primitive, or `None` for other prims."""
    kind = str(prim.GetTypeName())
    if kind == "Cube":
        return _cube(float(UsdGeom.Cube(prim).GetSizeAttr().Get()) / 2)
    if kind == "Plane":
        plane = UsdGeom.Plane(prim)
        axis = str(plane.GetAxisAttr().Get())
        half = plane.GetWidthAttr().Get() / 2, plane.GetLengthAttr().Get() / 2
        return _turned(_plane(*(half if axis == "Z" else half[::-1])), axis)
    if kind == "Sphere":
        radius = float(UsdGeom.Sphere(prim).GetRadiusAttr().Get())
        return _lathe(_arc(radius, 0.0, -math.pi / 2, math.pi / 2))
    profile = _profile(prim, kind)
    return None if profile is None else _turned(_lathe(profile), str(prim.GetAttribute("axis").Get() or "Z"))


def _profile(prim: Any, kind: str) -> list[tuple[float, float]] | None:
    """Returns radius and height along the axis, from bottom to top; `None` for kinds that are not rotational solids."""
    if not kind.startswith(("Cylinder", "Cone", "Capsule")):
        return None
    half = float(prim.GetAttribute("height").Get()) / 2
    names = ("radius", "radius") if prim.HasAttribute("radius") else ("radiusBottom", "radiusTop")
    bottom, top = (float(prim.GetAttribute(name).Get()) for name in names)
    if kind.startswith("Cone"):
        return [(bottom, -half), (0.0, half)]
    if kind.startswith("Cylinder"):
        return [(bottom, -half), (top, half)]
    return _arc(bottom, -half, -math.pi / 2, 0.0) + _arc(top, half, 0.0, math.pi / 2)


def _arc(radius: float, height: float, first: float, last: float) -> list[tuple[float, float]]:
    angles = np.linspace(first, last, 1 + round((last - first) / (math.pi / 2) * _STEPS_PER_QUARTER))
    return [(radius * math.cos(angle), height + radius * math.sin(angle)) for angle in angles]


def _cube(half: float) -> Polygons:
    square = [(-half, -half), (half, -half), (half, half), (-half, half)]
    points = np.array([(x, y, z) for z in (-half, half) for x, y in square])
    return points, np.full(6, 4), np.array(_CUBE)


def _plane(half_width: float, half_length: float) -> Polygons:
    w, h = half_width, half_length
    points = np.array([(-w, -h, 0.0), (w, -h, 0.0), (w, h, 0.0), (-w, h, 0.0)])
    return points, np.array([4]), np.arange(4)


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


def _turned(polygons: Polygons, axis: str) -> Polygons:
    points, counts, indices = polygons
    return points[:, _TURN[axis]], counts, indices
