"""Content of one 3D file before it is placed in a scene: shapes with their names, unit and up axis.

Data and pure functions. Does not read files. Errors list the size of the scene for each unit, so the user can choose.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from factory.scenes.importer.collect import Collector, Piece
from factory.scenes.importer.content import Colour, Surface
from factory.scenes.importer.polygons import bounds_volume, triangulate
from factory.scenes.importer.solids import Polygons
from factory.scenes.limits import StageLimits, Unit
from schemas.appearance.colour_names import linear_of
from schemas.errors import UsageError, WorldError
from schemas.support.numpy_types import Floats, Ints

METRES = MappingProxyType({"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254})
"""Unit -> metres."""
_PLAUSIBLE_M = (1.0, 2000.0)
_Y_TO_Z = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


def to_metres(metres_per_unit: float, up: str) -> Floats:
    """Returns the transform (4, 4) file -> metres, z up."""
    turn = _Y_TO_Z if up == "y" else np.eye(4)
    return np.asarray(np.diag([metres_per_unit] * 3 + [1.0]) @ turn)


def resolve_units(file: str, content: Content, limits: StageLimits) -> tuple[Floats, float]:
    """Returns the transform (4, 4) file -> metres, z up, and the length of the unit, metres.

    Args:
        file: name of the file, for messages.
        content: content of the file.
        limits: unit and up axis of the user, which override those of the file.

    Raises:
        UsageError: the unit or the up axis is neither stated in the file nor given by the user.
        WorldError: the scene would be implausibly small or large.
    """
    corners = content.corners()
    size = np.ptp(corners, axis=0) if len(corners) else np.zeros(3)
    unit = content.metres_per_unit if limits.unit is None else _length_of(limits.unit)
    up = limits.up or content.up
    missing = [
        *(["its unit (--unit m|cm|mm|in|METRES)"] if unit is None else []),
        *(["its up axis (--up y|z)"] if up is None else []),
    ]
    if unit is None or up is None:
        raise UsageError(f"{file} does not state {' and '.join(missing)}; {_sizes(size)}; a room is 2 to 4 m high")
    width = float(np.delete(size, "xyz".index(up)).max()) * unit
    if len(corners) and not _PLAUSIBLE_M[0] <= width <= _PLAUSIBLE_M[1]:
        raise WorldError(
            f"{file} is {width:.4g} m wide with a unit of {unit:g} m, which is implausible for a scene; "
            f"{_sizes(size)}; give the unit with --unit m|cm|mm|in|METRES"
        )
    return to_metres(unit, up), unit


def _length_of(unit: Unit) -> float:
    return unit if isinstance(unit, float) else METRES[unit]


def _sizes(size: Floats) -> str:
    lines = (
        f"{' x '.join(f'{value * metres:.3g}' for value in size)} m with {unit}" for unit, metres in METRES.items()
    )
    return f"its size (x, y, z) is {', '.join(lines)}"


ROOT = "/World"
"""Path of the root of every scene that is not USD."""
LIGHTS_NOTE = "lights of the file are not used; emissive materials light the scene"
BROKEN = (ValueError, TypeError, LookupError, ArithmeticError, AttributeError, RuntimeError)
"""Exceptions that a reader raises for a malformed file. RuntimeError includes RecursionError."""
LABEL_KEYS = ("semantic_label", "semantic", "category", "class", "label")
"""Keys of extra data that can contain a semantic label, in order of precedence."""
_UNSAFE = re.compile(r"[^\w.-]+")
_COLLIDER_NAME = re.compile(r"^(ucx|ubx|usp|ucp)_|(^|[_.-])(hit|collision)_?box(es)?([_.\d-]|$)", re.IGNORECASE)


@dataclass(frozen=True)
class ShapeNode:
    """Node of a file with geometry."""

    path: str
    """Path below the root of the file; starts with / unless empty."""
    pieces: tuple[Piece, ...]
    to_root: Floats
    """(4, 4) transform node -> file, for column vectors."""


@dataclass
class Content:
    """Content of one 3D file."""

    metres_per_unit: float | None
    """Length of the unit, metres; `None` if the file does not state it."""
    up: str | None
    """`y` or `z`; `None` if the file does not state it."""
    shapes: list[ShapeNode] = field(default_factory=list)
    labels: dict[str, str] = field(default_factory=dict)
    """Path below the root of the file -> semantic label."""

    def corners(self) -> Floats:
        """Returns all corners (N, 3) in the unit and axes of the file."""
        placed = [
            piece.triangles.reshape(-1, 3) @ shape.to_root[:3, :3].T + shape.to_root[:3, 3]
            for shape in self.shapes
            for piece in shape.pieces
        ]
        return np.concatenate(placed) if placed else np.zeros((0, 3))


def place_content(scene: Collector, path: str, content: Content, to_world: Floats, is_collider: bool = False) -> None:
    """Adds the shapes of a file to a scene; a shape that is not finite adds a note.

    Args:
        scene: scene that receives the shapes.
        path: path of the node that refers to the file.
        content: content of the file.
        to_world: (4, 4) transform file -> world metres.
        is_collider: whether the shapes are for collision only.
    """
    for shape in content.shapes:
        collides = is_collider or bool(_COLLIDER_NAME.search(shape.path.rpartition("/")[2]))
        try:
            with np.errstate(all="ignore"):
                scene.place(path + shape.path, shape.pieces, to_world @ shape.to_root, collides)
        except BROKEN as error:
            scene.notes.append(f"{path + shape.path}: skipped, {error}")
    scene.labels.update({path + below: label for below, label in content.labels.items()})


def solid_piece(polygons: Polygons, surface: Surface, is_two_sided: bool = False) -> Piece:
    """Returns a piece of a geometric primitive in one colour."""
    points, counts, indices = polygons
    triangles = points[indices[triangulate(points, counts, indices).corners]]
    piece = Piece(triangles, None, None, surface)
    return piece.both_sides() if is_two_sided else piece


def mesh_piece(
    points: Floats,
    corners: Ints,
    surface: Surface,
    uvs: Floats | None = None,
    tints: Floats | None = None,
    is_two_sided: bool | None = None,
) -> Piece:
    """Returns a piece of triangles.

    Args:
        points: (N, 3) vertices.
        corners: (T, 3) vertex of each corner.
        surface: appearance.
        uvs: (T, 3, 2) texture coordinates.
        tints: (T, 3, 3) linear colours.
        is_two_sided: whether back faces are visible. `None`, for formats that do not state it, makes a mesh two-sided
            unless it bounds a volume.

    Raises:
        ValueError: points are not finite, or a corner is out of range.
    """
    if len(corners) and not 0 <= corners.min() <= corners.max() < len(points):
        raise ValueError(f"vertices {corners.min()} to {corners.max()} (from 0) are used, but there are {len(points)}")
    triangles = points[corners]
    if not np.isfinite(triangles).all():
        raise ValueError("points are not finite")
    piece = Piece(triangles, uvs, tints, surface)
    if is_two_sided is None:
        is_two_sided = len(corners) > 0 and not bounds_volume(points, corners)
    return piece.both_sides() if is_two_sided else piece


def display_colour(red: float, green: float, blue: float) -> Colour:
    """Converts an sRGB colour, 0..1, to a linear colour."""
    linear = linear_of(np.clip(np.array([red, green, blue], np.float64), 0.0, 1.0))
    return float(linear[0]), float(linear[1]), float(linear[2])


class Names:
    """Assigns unique paths below each parent."""

    def __init__(self) -> None:
        self._used: set[str] = set()

    def path(self, parent: str, name: str | None, default: str) -> str:
        """Returns the path of a child; a number is appended to a name that is used."""
        plain = _UNSAFE.sub("_", name or "").strip("_.")[:200] or default
        path, number = f"{parent}/{plain}", 1
        while path in self._used:
            path, number = f"{parent}/{plain}_{number}", number + 1
        self._used.add(path)
        return path


def label_of(extras: Mapping[str, object] | None) -> str:
    """Returns the semantic label in extra data, or an empty string."""
    data = extras if isinstance(extras, Mapping) else {}
    lower = {str(key).lower(): value for key, value in data.items()}
    return next(_texts(lower[key] for key in LABEL_KEYS if key in lower), "")


def _texts(values: Iterator[object]) -> Iterator[str]:
    return (value for value in values if isinstance(value, str) and value)
