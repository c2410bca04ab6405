"""Builds the basic polygon meshes of the built-in scenes: boxes, cushions, lathes, rods, cards, in metres.

All faces are counter-clockwise seen from outside; solids are closed unless stated otherwise. Does not use random
numbers or materials.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from schemas.support import portable
from schemas.support.geometry import cross
from schemas.support.numpy_types import Floats, Ints

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class AuthoredMesh:
    """Polygon mesh with shared points.

    Attributes:
        points: (n, 3) float64, metres, z up.
        counts: (m,) corners per polygon.
        indices: (k,) point of each corner.
        st: (k, 2) texture coordinates in [0, 1] per corner, or None for box projection in metres.
    """

    points: Floats
    counts: Ints
    indices: Ints
    st: Floats | None = None


def _mesh(points: Floats, faces: Sequence[Sequence[int]], st: Floats | None = None) -> AuthoredMesh:
    counts = np.array([len(face) for face in faces], dtype=np.int64)
    indices = np.array([corner for face in faces for corner in face], dtype=np.int64)
    return AuthoredMesh(np.asarray(points, dtype=np.float64), counts, indices, st)


def loft(rings: Floats) -> AuthoredMesh:
    """Builds a loft through a stack of rings, with both ends closed.

    Args:
        rings: (m, n, 3) metres; each ring counter-clockwise seen from beyond the last ring.
    """
    counts, indices = _loft_faces(*rings.shape[:2])
    return AuthoredMesh(rings.reshape(-1, 3).astype(np.float64), counts, indices)


@lru_cache(maxsize=1024)
def _loft_faces(levels: int, sides: int) -> tuple[Ints, Ints]:
    """Returns the corners per polygon and the point of each corner of a loft; equal lofts share these arrays."""
    ring = np.arange(sides)
    following = (ring + 1) % sides
    walls = [
        np.stack([low + ring, low + following, low + sides + following, low + sides + ring], axis=1)
        for low in range(0, (levels - 1) * sides, sides)
    ]
    quads = np.concatenate(walls)
    caps = np.concatenate([ring[::-1], (levels - 1) * sides + ring])
    counts = np.array([4] * len(quads) + [sides, sides], dtype=np.int64)
    indices = np.concatenate([quads.ravel(), caps])
    for shared in (counts, indices):
        shared.flags.writeable = False
    return counts, indices


def block(low: Vector, high: Vector) -> AuthoredMesh:
    """Returns an axis-aligned box between two corners."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    outline = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    return loft(np.array([[(x, y, z) for x, y in outline] for z in (z0, z1)]))


def fitted_block(low: Vector, high: Vector) -> AuthoredMesh:
    """Returns a box whose faces each show the whole texture once, upright on the sides."""
    plain = block(low, high)
    wall = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
    return AuthoredMesh(plain.points, plain.counts, plain.indices, np.array(wall * 6))


def open_block(low: Vector, high: Vector, faces: str, fitted: bool = False) -> AuthoredMesh:
    """Returns a box with some of its faces; the others are not visible.

    Args:
        low: lower corner, metres.
        high: upper corner, metres.
        faces: letters of the faces: S (towards -y), E (+x), N (+y), W (-x), B (below), T (above).
        fitted: whether each face shows the whole texture once.
    """
    whole = fitted_block(low, high) if fitted else block(low, high)
    corners = 4 * np.array(["SENWBT".index(face) for face in faces])[:, None] + np.arange(4)
    st = None if whole.st is None else whole.st[corners.ravel()]
    return AuthoredMesh(whole.points, whole.counts[: len(corners)], whole.indices[corners.ravel()], st)


def standing_block(low: Vector, high: Vector, fitted: bool = False, lid: bool = True) -> AuthoredMesh:
    """Returns a box without its bottom face and optionally without its top face, which are not visible."""
    return open_block(low, high, "SENWT" if lid else "SENW", fitted)


def uncapped(mesh: AuthoredMesh) -> AuthoredMesh:
    """Returns a loft, cylinder, rod or tube without its two end faces."""
    return AuthoredMesh(mesh.points, mesh.counts[:-2], mesh.indices[: -int(mesh.counts[-2:].sum())])


def cushion(low: Vector, high: Vector, bevel: float) -> AuthoredMesh:
    """Returns a box with all edges chamfered by `bevel` metres."""
    (x0, y0, z0), (x1, y1, z1) = low, high

    def octagon(inset: float, z: float) -> list[Vector]:
        a0, a1, b0, b1 = x0 + inset, x1 - inset, y0 + inset, y1 - inset
        c = min(bevel, 0.45 * (a1 - a0), 0.45 * (b1 - b0))  # a thin board's corners must not cross
        return [
            (a0 + c, b0, z), (a1 - c, b0, z), (a1, b0 + c, z), (a1, b1 - c, z),
            (a1 - c, b1, z), (a0 + c, b1, z), (a0, b1 - c, z), (a0, b0 + c, z),
        ]  # fmt: skip

    levels = [(bevel, z0), (0.0, z0 + bevel), (0.0, z1 - bevel), (bevel, z1)]
    return loft(np.array([octagon(inset, z) for inset, z in levels]))


def pad(low: Vector, high: Vector, bevel: float, is_loose: bool = False) -> AuthoredMesh:
    """Returns a box with its upper edges chamfered by `bevel` metres, and also its lower edges if `is_loose`."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    under = [(bevel, z0), (0.0, z0 + bevel)] if is_loose else [(0.0, z0)]
    levels = [*under, (0.0, z1 - bevel), (bevel, z1)]
    outlines = [((x0 + inset, x1 - inset), (y0 + inset, y1 - inset), z) for inset, z in levels]
    return loft(
        np.array([[(x[0], y[0], z), (x[1], y[0], z), (x[1], y[1], z), (x[0], y[1], z)] for x, y, z in outlines])
    )


def lathe(
    profile: Sequence[tuple[float, float]], at: tuple[float, float] = (0.0, 0.0), sides: int = 14
) -> AuthoredMesh:
    """Revolves a profile of (radius, z), listed bottom to top, around the vertical axis through `at`."""
    circle = np.stack(_circle(sides, 0.0), axis=1)
    rings = np.empty((len(profile), sides, 3))
    for level, (radius, z) in enumerate(profile):
        rings[level, :, :2] = circle * max(radius, 1e-3) + np.array(at)
        rings[level, :, 2] = z
    return loft(rings)


@lru_cache(maxsize=256)
def _circle(sides: int, shift: float) -> tuple[Floats, Floats]:
    """Returns cosines and sines of the corners of a regular polygon, turned by `shift` sides; the arrays are shared."""
    angle = 2 * math.pi * (np.arange(sides) + shift) / sides
    return portable.cos(angle), portable.sin(angle)


def cylinder(
    radius: float,
    z0: float,
    z1: float,
    at: tuple[float, float] = (0.0, 0.0),
    sides: int = 14,
    top: float | None = None,
) -> AuthoredMesh:
    """Returns an upright cylinder, or a cone frustum if the `top` radius is given."""
    return lathe([(radius, z0), (radius if top is None else top, z1)], at, sides)


def tube(path: Sequence[Vector], radius: float, sides: int = 6) -> AuthoredMesh:
    """Returns a round bar along a polyline; each ring is perpendicular to the mean of the adjacent directions."""
    points = np.array(path, dtype=np.float64)
    steps = np.diff(points, axis=0)
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    along = np.concatenate([steps[:1], steps[:-1] + steps[1:], steps[-1:]])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    aside = np.array([0.0, 0.0, 1.0]) if abs(along[0, 2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    cos, sin = _circle(sides, 0.5)
    rings = np.empty((len(points), sides, 3))
    for level, direction in enumerate(along):
        u = cross(aside, direction)
        u /= np.linalg.norm(u[None], axis=1)
        v = cross(direction, u)
        rings[level] = points[level] + radius * (cos[:, None] * u + sin[:, None] * v)
        aside = v
    return loft(rings)


def rod(start: Vector, end: Vector, radius: float, sides: int = 6) -> AuthoredMesh:
    """Returns a straight round bar between two points."""
    return tube([start, end], radius, sides)


def quad(corners: Sequence[Vector]) -> AuthoredMesh:
    """Returns a one-sided rectangle that shows the whole texture once.

    Args:
        corners: lower left, lower right, upper right, upper left, as seen from the front.
    """
    return _mesh(np.array(corners), [(0, 1, 2, 3)], np.array([(0, 0), (1, 0), (1, 1), (0, 1)], dtype=np.float64))


def card(outline: Sequence[Vector]) -> AuthoredMesh:
    """Returns a thin polygon that is visible from both sides, such as a leaf or a sheet of paper."""
    front = list(range(len(outline)))
    return _mesh(np.array(outline, dtype=np.float64), [front, front[::-1]])


def moved(
    mesh: AuthoredMesh, shift: Vector = (0.0, 0.0, 0.0), yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0
) -> AuthoredMesh:
    """Rotates about x by `roll`, about y by `pitch`, about z by `yaw` (radians), then shifts by `shift` (metres)."""
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    turn = portable.product(portable.product(about_z, about_y), about_x)
    points = portable.product(mesh.points, turn.T) + np.array(shift)
    return AuthoredMesh(points, mesh.counts, mesh.indices, mesh.st)


def bounds(meshes: Sequence[AuthoredMesh]) -> tuple[Floats, Floats]:
    """Returns the lower and upper corner of all meshes, metres."""
    points = np.concatenate([mesh.points for mesh in meshes])
    return points.min(axis=0), points.max(axis=0)


def triangle_count(mesh: AuthoredMesh) -> int:
    """Returns the number of triangles of the fan triangulation."""
    return int(np.sum(mesh.counts - 2))


def merge(meshes: Sequence[AuthoredMesh], tile_m: float) -> AuthoredMesh:
    """Joins meshes of one material; divides projected texture coordinates by `tile_m` metres."""
    offsets = np.cumsum([0] + [len(mesh.points) for mesh in meshes])
    return AuthoredMesh(
        np.concatenate([mesh.points for mesh in meshes]),
        np.concatenate([mesh.counts for mesh in meshes]),
        np.concatenate([mesh.indices + offset for mesh, offset in zip(meshes, offsets, strict=False)]),
        np.concatenate([_project(mesh) / tile_m if mesh.st is None else mesh.st for mesh in meshes]),
    )


def _project(mesh: AuthoredMesh) -> Floats:
    """Returns texture coordinates in metres, projected along the dominant axis of each polygon's normal."""
    corners = mesh.points[mesh.indices]
    starts = np.concatenate([[0], np.cumsum(mesh.counts)[:-1]])
    following = np.arange(len(corners)) + 1
    following[starts + mesh.counts - 1] = starts
    normals = np.add.reduceat(cross(corners, corners[following]), starts)
    axis = np.repeat(np.abs(normals).argmax(axis=1), mesh.counts)
    st = corners[:, :2].copy()
    st[axis == 0] = corners[axis == 0][:, 1:]
    st[axis == 1] = corners[axis == 1][:, ::2]
    return st
