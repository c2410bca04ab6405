"""Shapes of small objects as triangles with shades, scaled to a largest side of 1, and the shadows around their bases.

Pure functions.
"""

from __future__ import annotations

import functools
import math
from itertools import pairwise
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from schemas.support.numpy_types import Floats

_SIDES = 20
_LIGHT = np.array((0.30, -0.22, 0.93))
RADII = MappingProxyType({"ball": 0.5, "bottle": 0.17, "box": 0.62, "books": 0.66, "cone": 0.36})
"""For each kind of object, radius of the circle on the floor that contains it, as a share of its largest side."""
SHADOW_RINGS = ((0.0, 0.78, 0.55), (0.78, 0.9, 0.68), (0.9, 1.02, 0.81), (1.02, 1.14, 0.92))
"""Rings of the shadow of an object: inner and outer radius, in radii of the object, and remaining share of light."""


class ClutterShape(NamedTuple):
    """Triangles of an object on the plane z = 0."""

    triangles: Floats
    """(T, 3, 3) corners, counter-clockwise seen from outside."""
    shades: Floats
    """(T, 3) factors that multiply the red, green and blue of the object's colour."""


@functools.cache
def shape_of(kind: str) -> ClutterShape:
    """Returns the shape of a kind of object.

    Raises:
        KeyError: unknown kind.
    """
    return _SHAPES[kind]()


def _shaded(triangles: Floats, tint: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> ClutterShape:
    """Shades triangles by their normals, because the baked light does not include the object."""
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.maximum(np.sqrt((cross**2).sum(axis=1)), 1e-12)
    facing = (cross * _LIGHT).sum(axis=1) / length
    shade = 0.62 + 0.38 * np.clip(facing, -1, 1)
    return ClutterShape(triangles, shade[:, None] * np.array(tint))


def _joined(*shapes: ClutterShape) -> ClutterShape:
    triangles, shades = zip(*shapes, strict=True)
    return ClutterShape(np.concatenate(triangles), np.concatenate(shades))


def _box(size: tuple[float, float, float], low_z: float = 0.0, yaw: float = 0.0) -> Floats:
    """Returns the triangles of a box whose base is centred on the z axis."""
    x, y = size[0] / 2, size[1] / 2
    base = np.array(((-x, -y), (x, -y), (x, y), (-x, y)))
    turn = np.array(((math.cos(yaw), math.sin(yaw)), (-math.sin(yaw), math.cos(yaw))))
    base = (base[:, :, None] * turn).sum(axis=1)
    low, high = (np.column_stack((base, np.full(4, z))) for z in (low_z, low_z + size[2]))
    faces = [high] + [np.array((low[k], low[(k + 1) % 4], high[(k + 1) % 4], high[k])) for k in range(4)]
    faces.append(low[::-1])
    return np.concatenate([_fan(face) for face in faces])


def _fan(face: Floats) -> Floats:
    return np.array([(face[0], face[k], face[k + 1]) for k in range(1, len(face) - 1)])


def _turned(profile: tuple[tuple[float, float], ...]) -> Floats:
    """Returns the triangles of a body of revolution about z.

    Args:
        profile: radius and height from the bottom to the top; a radius of 0 closes it.
    """
    angles = [2 * math.pi * k / _SIDES for k in range(_SIDES)]
    ring = np.array([(math.cos(angle), math.sin(angle)) for angle in angles])
    levels = [np.column_stack((ring * radius, np.full(_SIDES, height))) for radius, height in profile]
    found = []
    for low, high in pairwise(levels):
        for k in range(_SIDES):
            j = (k + 1) % _SIDES
            found += [(low[k], low[j], high[j]), (low[k], high[j], high[k])]
    return np.array(found)


def _ball() -> ClutterShape:
    steps = [math.pi * k / 12 for k in range(13)]
    return _shaded(_turned(tuple((0.5 * math.sin(a), 0.5 - 0.5 * math.cos(a)) for a in steps)))


def _bottle() -> ClutterShape:
    body = _turned(((0, 0), (0.14, 0), (0.15, 0.02), (0.15, 0.62), (0.12, 0.72), (0.05, 0.82), (0.05, 0.9)))
    cap = _turned(((0.0, 0.9), (0.06, 0.9), (0.06, 1.0), (0.0, 1.0)))
    return _joined(_shaded(body), _shaded(cap, (0.35, 0.35, 0.35)))


def _carton() -> ClutterShape:
    return _joined(_shaded(_box((1.0, 0.7, 0.55))), _shaded(_box((1.002, 0.12, 0.551), 0.0005), (0.86, 0.86, 0.86)))


def _books() -> ClutterShape:
    found, height = [], 0.0
    for size, yaw, tint in (
        ((1.0, 0.72, 0.13), 0.0, 1.0),
        ((0.86, 0.62, 0.1), 0.35, 0.75),
        ((0.8, 0.58, 0.15), -0.2, 1.1),
    ):
        found.append(_shaded(_box((size[0], size[1], 0.2 * size[2]), height, yaw), (tint,) * 3))
        pages = (0.96 * size[0], 0.96 * size[1], 0.6 * size[2])
        found.append(_shaded(_box(pages, height + 0.2 * size[2], yaw), (1.6, 1.6, 1.55)))
        found.append(_shaded(_box((size[0], size[1], 0.2 * size[2]), height + 0.8 * size[2], yaw), (tint,) * 3))
        height += size[2]
    return _joined(*found)


def _cone() -> ClutterShape:
    plate = _box((0.5, 0.5, 0.04))
    lower = _turned(((0.19, 0.04), (0.125, 0.4)))
    band = _turned(((0.125, 0.4), (0.085, 0.62)))
    top = _turned(((0.085, 0.62), (0.03, 0.96), (0.0, 0.97)))
    return _joined(_shaded(plate, (0.4, 0.4, 0.4)), _shaded(lower), _shaded(band, (1.7, 1.7, 1.7)), _shaded(top))


_SHAPES = {"ball": _ball, "bottle": _bottle, "box": _carton, "books": _books, "cone": _cone}
