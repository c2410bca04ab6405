"""Builds a building with one straight corridor and rooms on both sides, for the office and the hospital.

Builds floors, walls, doors, windows and ceilings from a list of cells. Does not place furniture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from numpy.random import Generator

from factory.scenes.author.geometry import block, fitted_block
from factory.scenes.author.materials import PropPiece, SurfaceMaterial, painted, textured, tinted
from factory.scenes.author.placement import FloorPlan, Rectangle, RoomRecord
from factory.scenes.author.room import PLAIN, WALL_THICKNESS_M, Doorway, Trim, ceiling, floor, wall

PLASTER = tinted("Plaster", "WallPlaster", colour="#dedbd1", tile_m=0.8, roughness=0.9)
CEILING = textured("CeilingTile", "#e6e5e0", 1.2, 0.9)
LEAF = textured("DoorLeaf", "#8a5f3c", 1.0, 0.5)
GRIP = painted("Steel", 0.35, 1.0)


@dataclass(frozen=True)
class Style:
    """Style of a kind of room: floor, wall paint, windows and trim."""

    floor: SurfaceMaterial
    paint: SurfaceMaterial
    has_windows: bool = True
    trim: Trim = PLAIN


@dataclass(frozen=True)
class Cell:
    """Specification of a room: kind, minimum width and clear door width, metres."""

    kind: str
    width: float
    door_width: float


@dataclass(frozen=True)
class Room:
    """Room of the building.

    Attributes:
        kind: use of the room.
        area: floor between the wall faces, metres.
        door: door in the corridor wall.
        outer: side of the outer wall, N or S.
        inner: side of the corridor wall.
    """

    kind: str
    area: Rectangle
    door: Doorway
    outer: str
    inner: str


def divide(rng: Generator, cells: Sequence[Cell], length: float) -> list[tuple[Cell, float, float]]:
    """Divides `length` metres among the cells in proportion to their widths, which are varied at random."""
    weights = [cell.width * float(rng.uniform(0.95, 1.1)) for cell in cells]
    spans: list[tuple[Cell, float, float]] = []
    x = 0.0
    for cell, weight in zip(cells, weights, strict=True):
        width = length * weight / sum(weights)
        spans.append((cell, x, x + width))
        x += width
    return spans


def build_wings(
    plan: FloorPlan,
    size: tuple[float, float],
    corridor: tuple[float, float],
    wings: dict[str, list[tuple[Cell, float, float]]],
    styles: dict[str, Style],
    height: float = 2.8,
) -> list[Room]:
    """Builds the corridor and both wings.

    Args:
        plan: receives the structures.
        size: outer width (x) and depth (y), metres.
        corridor: lower and upper y of the corridor, metres.
        wings: cells with their x span, for "S" and "N".
        styles: style by room kind, including the kind "corridor".
        height: height of all walls, metres.

    Returns:
        The rooms, south wing first.
    """
    hall = Rectangle(0.0, corridor[0], size[0], corridor[1])
    hall_style = styles["corridor"]
    floor(plan, hall, hall_style.floor)
    ceiling(plan, hall, height, CEILING)
    for x in (0.0, size[0]):
        trims = (None, hall_style.trim) if x == 0.0 else (hall_style.trim, None)
        wall(
            plan,
            False,
            at=x,
            span=(hall.y0, hall.y1),
            faces=(hall_style.paint, hall_style.paint),
            doors=(),
            height=height,
            trims=trims,
        )
    rooms: list[Room] = []
    for side, spans in wings.items():
        depth = (0.0, corridor[0]) if side == "S" else (corridor[1], size[1])
        rooms += _build_wing(plan, side, depth=depth, spans=spans, styles=styles, height=height)
    plan.rooms += [RoomRecord(room.kind, room.area, (len(rooms),)) for room in rooms]
    plan.rooms.append(RoomRecord("corridor", hall, tuple(range(len(rooms)))))
    return rooms


def _build_wing(
    plan: FloorPlan,
    side: str,
    depth: tuple[float, float],
    spans: list[tuple[Cell, float, float]],
    styles: dict[str, Style],
    height: float,
) -> list[Room]:
    """Builds one row of rooms between the outer wall and the corridor."""
    is_south = side == "S"
    outer_y, inner_y = depth if is_south else depth[::-1]
    hall_paint, rooms = styles["corridor"].paint, []
    previous: Style | None = None
    build = partial(wall, plan, height=height)
    for cell, x0, x1 in spans:
        style = styles[cell.kind]
        area = Rectangle(x0, depth[0], x1, depth[1])
        floor(plan, area, style.floor)
        ceiling(plan, area, height, CEILING)
        door = _draw_door(plan.rng, cell, x0, x1)
        inner_faces = (style.paint, hall_paint) if is_south else (hall_paint, style.paint)
        hall_trim = styles["corridor"].trim
        build(
            True,
            at=inner_y,
            span=(x0, x1),
            faces=inner_faces,
            doors=(door,),
            trims=_facing(is_south, style.trim, hall_trim),
        )
        build(
            True,
            at=outer_y,
            span=(x0, x1),
            faces=(style.paint, style.paint),
            doors=(),
            trims=_facing(is_south, None, style.trim),
        )
        before = style if previous is None else previous
        trims = (None if previous is None else previous.trim, style.trim)
        build(False, at=x0, span=depth, faces=(before.paint, style.paint), doors=(), trims=trims)
        previous = style
        inside = area.grown(-WALL_THICKNESS_M / 2)
        room = Room(cell.kind, inside, door=door, outer=side, inner="N" if is_south else "S")
        rooms.append(room)
        _hang_leaves(plan, room)
        if style.has_windows:
            _hang_windows(plan, room)
    last = styles[spans[-1][0].kind]
    build(False, at=spans[-1][2], span=depth, faces=(last.paint, last.paint), doors=(), trims=(last.trim, None))
    return rooms


def _facing(is_south: bool, first: Trim | None, second: Trim | None) -> tuple[Trim | None, Trim | None]:
    """Returns the two trims of a wall along x in the order of its faces, which is reversed in the north wing."""
    return (first, second) if is_south else (second, first)


def _draw_door(rng: Generator, cell: Cell, x0: float, x1: float) -> Doorway:
    reach = cell.door_width / 2 + 0.35
    return Doorway(float(rng.uniform(x0 + reach, x1 - reach)), cell.door_width)


def _hang_leaves(plan: FloorPlan, room: Room) -> None:
    """Adds open door leaves against the corridor wall, on each side of the door where they fit."""
    width = room.door.width if room.door.width <= 1.3 else room.door.width / 2
    face, into = (room.area.y1, -1.0) if room.inner == "N" else (room.area.y0, 1.0)
    sides = (1.0, -1.0) if width < room.door.width else (1.0 if plan.rng.random() < 0.5 else -1.0,)
    for side in sides:
        hinge = room.door.centre + side * (room.door.width / 2 + 0.06)
        x0, x1 = sorted((hinge, hinge + side * width))
        if x0 < room.area.x0 + 0.05 or x1 > room.area.x1 - 0.05:
            continue
        y0, y1 = sorted((face + into * 0.025, face + into * 0.065))
        grip = x1 - 0.12 if side > 0 else x0 + 0.06
        g0, g1 = sorted((face + into * 0.065, face + into * 0.10))
        plan.build(
            "SM_DoorLeaf",
            PropPiece(LEAF, fitted_block((x0, y0, 0.01), (x1, y1, room.door.height - 0.02))),
            PropPiece(GRIP, block((grip, g0, 0.98), (grip + 0.06, g1, 1.01))),
        )
        plan.taken.append(Rectangle(x0, y0 - 0.05, x1, y1 + 0.05))


def _hang_windows(plan: FloorPlan, room: Room) -> None:
    """Adds windows to the outer wall at a pitch of about 2.2 m."""
    count = max(1, int(room.area.width // 2.3))
    model = plan.props.model("SM_Window", 0)
    for index in range(count):
        x = room.area.x0 + (index + 0.5) * room.area.width / count
        y = room.area.y0 if room.outer == "S" else room.area.y1
        plan.add(model, x, y, 0.0 if room.outer == "N" else 3.141592653589793)
