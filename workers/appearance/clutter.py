"""Places small objects on the floor beside the path of the robot: their shapes, shadows and poses. Pure functions.

The robot drives without the objects, so each object keeps a clearance from the footprint at every pose. It is outside
of the area between the robot and the target at the first and the last pose, so it hides no pixel of the target at these
poses.
"""

from __future__ import annotations

import functools
import math
from itertools import pairwise
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import scipy  # loads a submodule at its first use; many commands use no submodule

from schemas.appearance import ClutterObject, ClutterRanges
from schemas.scene import CompiledScene, Target
from schemas.support import portable
from schemas.support.numpy_types import Bools, Floats
from workers.appearance.factor_stream import FactorStream
from workers.appearance.floor import FloorUnder
from workers.geometry.grid import DISC_OFFSETS_M, DISC_RADIUS_M, Grid

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


def _solid_box(size: tuple[float, float, float], low_z: float = 0.0, yaw: float = 0.0) -> Floats:
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
    triangles = []
    for low, high in pairwise(levels):
        for k in range(_SIDES):
            j = (k + 1) % _SIDES
            triangles += [(low[k], low[j], high[j]), (low[k], high[j], high[k])]
    return np.array(triangles)


def _ball() -> ClutterShape:
    steps = [math.pi * k / 12 for k in range(13)]
    return _shaded(_turned(tuple((0.5 * math.sin(a), 0.5 - 0.5 * math.cos(a)) for a in steps)))


def _bottle() -> ClutterShape:
    body = _turned(((0, 0), (0.14, 0), (0.15, 0.02), (0.15, 0.62), (0.12, 0.72), (0.05, 0.82), (0.05, 0.9)))
    cap = _turned(((0.0, 0.9), (0.06, 0.9), (0.06, 1.0), (0.0, 1.0)))
    return _joined(_shaded(body), _shaded(cap, (0.35, 0.35, 0.35)))


def _carton() -> ClutterShape:
    return _joined(
        _shaded(_solid_box((1.0, 0.7, 0.55))), _shaded(_solid_box((1.002, 0.12, 0.551), 0.0005), (0.86, 0.86, 0.86))
    )


def _books() -> ClutterShape:
    parts, height = [], 0.0
    for size, yaw, tint in (
        ((1.0, 0.72, 0.13), 0.0, 1.0),
        ((0.86, 0.62, 0.1), 0.35, 0.75),
        ((0.8, 0.58, 0.15), -0.2, 1.1),
    ):
        parts.append(_shaded(_solid_box((size[0], size[1], 0.2 * size[2]), height, yaw), (tint,) * 3))
        pages = (0.96 * size[0], 0.96 * size[1], 0.6 * size[2])
        parts.append(_shaded(_solid_box(pages, height + 0.2 * size[2], yaw), (1.6, 1.6, 1.55)))
        parts.append(_shaded(_solid_box((size[0], size[1], 0.2 * size[2]), height + 0.8 * size[2], yaw), (tint,) * 3))
        height += size[2]
    return _joined(*parts)


def _cone() -> ClutterShape:
    plate = _solid_box((0.5, 0.5, 0.04))
    lower = _turned(((0.19, 0.04), (0.125, 0.4)))
    band = _turned(((0.125, 0.4), (0.085, 0.62)))
    top = _turned(((0.085, 0.62), (0.03, 0.96), (0.0, 0.97)))
    return _joined(_shaded(plate, (0.4, 0.4, 0.4)), _shaded(lower), _shaded(band, (1.7, 1.7, 1.7)), _shaded(top))


_SHAPES = {"ball": _ball, "bottle": _bottle, "box": _carton, "books": _books, "cone": _cone}


COLOURS = (
    "#b5201c",
    "#e0701a",
    "#e8b81c",
    "#2c8a3c",
    "#1f7f82",
    "#1d4fa8",
    "#5b9bd5",
    "#6a3d8f",
    "#d884a8",
    "#6b4226",
    "#cdb892",
    "#eeeeea",
    "#85888c",
    "#3a3c40",
    "#1c2b52",
    "#3f7d4a",
)
"""Colours of the objects."""
_GAP_M = 0.05
"""Free space between an object and anything else, metres."""
_VIEW_MARGIN_M = 0.15
"""Margin around the area between the robot and the target, metres. The area begins at base_link, but the cameras are
mounted beside it, and are displaced by centimetres."""


def place_clutter(
    ranges: ClutterRanges, stream: FactorStream, scene: CompiledScene, target: Target, poses: Floats
) -> tuple[ClutterObject, ...]:
    """Returns the objects of an episode.

    Args:
        ranges: number, kinds and sizes of the objects.
        stream: random numbers.
        scene: compiled scene.
        target: object that stays in view.
        poses: (T, 7) poses of base_link: x, y, z in metres and the quaternion w, x, y, z.
    """
    grid, floor = Grid.from_scene(scene), FloorUnder(scene)
    swept = _distance_to_path(grid, poses)
    room = np.minimum(grid.clearance - grid.resolution_m, swept - DISC_RADIUS_M - ranges.clearance_m)
    room[(swept > ranges.reach_m) | _in_view(grid, target, poses)] = 0.0
    placed: list[ClutterObject] = []
    low, high = ranges.count
    for _ in range(low + stream.below(high - low + 1)):
        kind, size, colour = stream.choose(ranges.kinds), stream.between(ranges.size_m, 3), stream.choose(COLOURS)
        yaw, pick = stream.between((-180.0, 180.0), 1), stream.share()
        radius = RADII[kind] * size + _GAP_M
        cells = np.flatnonzero(room.ravel() >= radius)
        if not len(cells):
            continue
        cell = np.unravel_index(cells[int(pick * len(cells))], room.shape)
        x, y = (round(float(value), 3) for value in grid.centre_of(np.array(cell)))
        if floor.triangle_at(x, y) is None:
            continue
        placed.append(ClutterObject(kind=kind, x_m=x, y_m=y, yaw_deg=yaw, size_m=size, colour=colour))
        rows, columns = np.ogrid[: room.shape[0], : room.shape[1]]
        gaps = np.hypot(rows - cell[0], columns - cell[1]) * grid.resolution_m - radius
        room = np.minimum(room, np.maximum(gaps, 0.0))
    return tuple(placed)


def _distance_to_path(grid: Grid, poses: Floats) -> Floats:
    """Returns lower bounds (H, W) of the distances from the cells to the path, metres.

    The path consists of the centres of the footprint's discs at all poses.
    """
    yaw = np.array([_yaw(*row[3:]) for row in poses])
    along = np.asarray(DISC_OFFSETS_M)
    x = poses[:, 0, None] + along * portable.cos(yaw)[:, None]
    y = poses[:, 1, None] + along * portable.sin(yaw)[:, None]
    cells = grid.cell_of(np.stack((x, y), axis=-1)).reshape(-1, 2)
    free = np.ones(grid.occupancy.shape, bool)
    inside = ((cells >= 0) & (cells < free.shape)).all(axis=1)
    free[tuple(cells[inside].T)] = False
    field = scipy.ndimage.distance_transform_edt(free) * grid.resolution_m
    return np.asarray(field - grid.resolution_m)  # a lower bound, because both points may be anywhere in their cells


def _yaw(qw: float, qx: float, qy: float, qz: float) -> float:
    return math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))


def _in_view(grid: Grid, target: Target, poses: Floats) -> Bools:
    """Returns the cells (H, W) in or near the area between the robot and the target, at the first or the last pose."""
    rows, columns = np.indices(grid.occupancy.shape)
    points = grid.centre_of(np.stack((rows, columns), axis=-1).reshape(-1, 2))
    corners = np.array(target.footprint_m or _box(target))
    near = np.zeros(len(points), bool)
    for pose in (poses[0], poses[-1]):
        hull = _hull(np.vstack((pose[None, :2], corners)))
        near |= _distance_to_hull(points, hull) < _VIEW_MARGIN_M + grid.resolution_m + max(RADII.values()) * 0.5
    return near.reshape(grid.occupancy.shape)


def _box(target: Target) -> list[tuple[float, float]]:
    (left, low), (right, high) = target.taken_m
    return [(left, low), (right, low), (right, high), (left, high)]


def _hull(points: Floats) -> Floats:
    """Returns the convex hull, counter-clockwise (Andrew's monotone chain)."""
    ordered = sorted(set(map(tuple, points.tolist())))

    def half(items: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
        chain: list[tuple[float, ...]] = []
        for item in items:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], item) <= 0:
                chain.pop()
            chain.append(item)
        return chain[:-1]

    return np.array(half(ordered) + half(ordered[::-1]))


def _turn(a: tuple[float, ...], b: tuple[float, ...], c: tuple[float, ...]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _distance_to_hull(points: Floats, hull: Floats) -> Floats:
    """Returns the distances (N,) from points to a convex polygon, metres; 0 inside."""
    ends = np.roll(hull, -1, axis=0)
    least, inside = np.full(len(points), np.inf), np.ones(len(points), bool)
    for start, end in zip(hull, ends, strict=True):
        side = end - start
        gap = points - start
        share = np.clip((gap[:, 0] * side[0] + gap[:, 1] * side[1]) / max(float((side**2).sum()), 1e-12), 0, 1)
        off = gap - share[:, None] * side
        least = np.minimum(least, np.sqrt((off**2).sum(axis=1)))
        inside &= side[0] * gap[:, 1] - side[1] * gap[:, 0] >= 0
    return np.where(inside, 0.0, least)
