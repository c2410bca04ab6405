"""Builds the rooms of a divided floor: floors, walls with doors, ceilings with lamps, windows with curtains.

Does not divide the floor and does not furnish.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

from factory.scenes.author.geometry import AuthoredMesh, block, lathe, open_block, quad
from factory.scenes.author.materials import PropPiece, SurfaceMaterial, glowing, painted, tinted, wood
from factory.scenes.author.partition import Division, Opening
from factory.scenes.author.placement import FACING, FloorPlan, Rectangle, RoomRecord
from factory.scenes.author.room import LAMP, LAMP_RIM, PLATE, WALL_THICKNESS_M, Trim, floor, wall

_SIDES = "SNWE"
GRIP = painted("Steel", 0.35, 1.0)
_CEILING = tinted("Plaster", "CeilingPlaster", "#eeece6", 1.0, 0.9)


class RoomLook(NamedTuple):
    """Look of a kind of room: floor, walls, window view and curtain; a room without windows has `windows` 0."""

    floor: SurfaceMaterial
    paint: SurfaceMaterial
    windows: int = 2
    """Largest number of windows in a wall."""
    curtain: int | None = None
    """Variant of the curtains, or `None` for none."""


@dataclass(frozen=True)
class BuildingLook:
    """Look of a building.

    Attributes:
        looks: look by kind of room.
        trim: trim of all walls.
        leaf: material of the door leaves.
        ceiling: plain, beams, boards or panels.
        views: variants of the windows to the south and west, and to the north and east.
        height: height of the rooms, metres.
    """

    looks: Mapping[str, RoomLook]
    trim: Trim
    leaf: SurfaceMaterial
    ceiling: str = "plain"
    views: tuple[int, int] = (0, 0)
    height: float = 2.6


@dataclass
class BuiltRoom:
    """Room: kind, floor between the wall faces, sides with windows, openings by side and neighbours."""

    number: int
    kind: str
    area: Rectangle
    outer: str = ""
    """Sides on the outer wall."""
    doors: dict[str, list[float]] = field(default_factory=dict)
    """Centres of the openings by side, metres."""
    neighbours: list[int] = field(default_factory=list)

    def closed_sides(self) -> str:
        """Returns the sides without an opening."""
        return "".join(side for side in _SIDES if side not in self.doors)


def build_rooms(plan: FloorPlan, division: Division, building: BuildingLook) -> list[BuiltRoom]:
    """Adds the structures of all rooms and returns the rooms."""
    rooms = _built_rooms(division)
    for room, area in zip(rooms, division.areas, strict=True):
        floor(plan, area, building.looks[room.kind].floor)
        _ceiling(plan, area, building)
    for piece in _wall_runs(division.areas):
        _build_wall(plan, piece, division, building)
    for opening in division.openings:
        if opening.doorway.height < 2.2:
            _hang_leaf(plan, opening, division, building)
    for room in rooms:
        _hang_windows(plan, room, building)
    plan.rooms += [RoomRecord(room.kind, room.area, tuple(room.neighbours)) for room in rooms]
    return rooms


def _built_rooms(division: Division) -> list[BuiltRoom]:
    x0, y0 = min(a.x0 for a in division.areas), min(a.y0 for a in division.areas)
    x1, y1 = max(a.x1 for a in division.areas), max(a.y1 for a in division.areas)
    rooms = []
    for number, (spec, area) in enumerate(zip(division.specs, division.areas, strict=True)):
        edges = {"S": area.y0 - y0, "N": y1 - area.y1, "W": area.x0 - x0, "E": x1 - area.x1}
        outer = "".join(side for side in _SIDES if edges[side] < 1e-6)
        rooms.append(BuiltRoom(number, spec.kind, area.grown(-WALL_THICKNESS_M / 2), outer))
    for opening in division.openings:
        for own, other in (opening.rooms, opening.rooms[::-1]):
            area = division.areas[own]
            ahead = abs(opening.at - (area.y1 if opening.is_along_x else area.x1)) < 1e-6
            side = ("SN" if opening.is_along_x else "WE")[ahead]
            rooms[own].doors.setdefault(side, []).append(opening.doorway.centre)
            rooms[own].neighbours.append(other)
    return rooms


class _Run(NamedTuple):
    """Straight wall between the same two rooms; `None` is the outside."""

    is_along_x: bool
    at: float
    span: tuple[float, float]
    below: int | None
    above: int | None


def _wall_runs(areas: Sequence[Rectangle]) -> Iterator[_Run]:
    """Yields all walls, each as long as the rooms on its sides stay the same."""
    for is_along_x in (True, False):
        edges = [(a.y0, a.y1, a.x0, a.x1) if is_along_x else (a.x0, a.x1, a.y0, a.y1) for a in areas]
        for at in sorted({round(value, 6) for edge in edges for value in edge[:2]}):
            marks = sorted({round(v, 6) for e in edges if min(abs(e[0] - at), abs(e[1] - at)) < 1e-5 for v in e[2:]})
            run: _Run | None = None
            for low, high in pairwise(marks):
                middle = (low + high) / 2
                inside = [k for k, e in enumerate(edges) if e[2] < middle < e[3]]
                below = next((k for k in inside if abs(edges[k][1] - at) < 1e-5), None)
                above = next((k for k in inside if abs(edges[k][0] - at) < 1e-5), None)
                if run is not None and (run.below, run.above) == (below, above):
                    run = run._replace(span=(run.span[0], high))
                    continue
                if run is not None:
                    yield run
                run = None if below is above is None else _Run(is_along_x, at, (low, high), below, above)
            if run is not None:
                yield run


def _build_wall(plan: FloorPlan, run: _Run, division: Division, building: BuildingLook) -> None:
    looks = [None if room is None else building.looks[division.specs[room].kind] for room in (run.below, run.above)]
    shown = next(look for look in looks if look is not None)
    faces = tuple((look or shown).paint for look in looks)
    trims = tuple(None if look is None else building.trim for look in looks)
    doors = [
        opening.doorway
        for opening in division.openings
        if opening.is_along_x == run.is_along_x
        and abs(opening.at - run.at) < 1e-5
        and run.span[0] < opening.doorway.centre < run.span[1]
    ]
    wall(plan, run.is_along_x, run.at, run.span, (faces[0], faces[1]), doors, building.height, (trims[0], trims[1]))


def _hang_leaf(plan: FloorPlan, opening: Opening, division: Division, building: BuildingLook) -> None:
    """Adds an open door leaf flat against the wall, in the room and on the side where the wall is long enough."""
    door = opening.doorway
    for room in opening.rooms[:: 1 if plan.rng.random() < 0.5 else -1]:
        area = division.areas[room].grown(-WALL_THICKNESS_M / 2)
        span = (area.x0, area.x1) if opening.is_along_x else (area.y0, area.y1)
        face_low, face_high = (area.y0, area.y1) if opening.is_along_x else (area.x0, area.x1)
        is_low = abs(face_low - opening.at) < 0.2
        face, into = (face_low, 1.0) if is_low else (face_high, -1.0)
        for side in (1.0, -1.0):
            hinge = door.centre + side * (door.width / 2 + 0.09)
            a0, a1 = sorted((hinge, hinge + side * door.width))
            if a0 < span[0] + 0.04 or a1 > span[1] - 0.04:
                continue
            c0, c1 = sorted((face + into * 0.02, face + into * 0.06))
            zone = (
                Rectangle(a0, c0 - 0.04, a1, c1 + 0.04)
                if opening.is_along_x
                else Rectangle(c0 - 0.04, a0, c1 + 0.04, a1)
            )
            if any(zone.overlaps(other) for other in plan.taken):
                continue
            low, high = ((a0, c0), (a1, c1)) if opening.is_along_x else ((c0, a0), (c1, a1))
            leaf = block((*low, 0.01), (*high, door.height - 0.02))
            plan.build(
                "SM_DoorLeaf",
                PropPiece(building.leaf, leaf),
                *_leaf_trim(building, (low, high), opening.is_along_x, into),
            )
            plan.taken.append(zone)
            return


def _leaf_trim(
    building: BuildingLook, ends: tuple[tuple[float, float], tuple[float, float]], is_along_x: bool, into: float
) -> Iterator[PropPiece]:
    """Yields two raised panels and a handle on the face of a leaf towards the room."""
    (x0, y0), (x1, y1) = ends
    a0, a1, face = (x0, x1, y1 if into > 0 else y0) if is_along_x else (y0, y1, x1 if into > 0 else x0)

    def bar(along: tuple[float, float], proud: float, z: tuple[float, float]) -> AuthoredMesh:
        c0, c1 = sorted((face, face + into * proud))
        low, high = ((along[0], c0), (along[1], c1)) if is_along_x else ((c0, along[0]), (c1, along[1]))
        return block((*low, z[0]), (*high, z[1]))

    for z in ((0.18, 0.92), (1.10, 1.92)):
        yield PropPiece(building.leaf, bar((a0 + 0.14, a1 - 0.14), 0.012, z))
    yield PropPiece(GRIP, bar((a1 - 0.11, a1 - 0.02), 0.045, (1.0, 1.02)))


def _ceiling(plan: FloorPlan, area: Rectangle, building: BuildingLook) -> None:
    """Adds a ceiling: plain, with beams, of boards or with lit panels; and round or square lamps."""
    top = building.height
    slab = {"boards": tinted("Boards", "CeilingBoards", "#d9b98a", 1.2, 0.6)}.get(building.ceiling, _CEILING)
    plan.build("SM_Ceiling", PropPiece(slab, block((area.x0, area.y0, top), (area.x1, area.y1, top + 0.05))))
    if building.ceiling == "beams":
        count = max(1, round(area.depth / 1.1))
        rows = [area.y0 + (row + 0.5) * area.depth / count for row in range(count)]
        beams = [open_block((area.x0, y - 0.07, top - 0.14), (area.x1, y + 0.07, top), "SNB") for y in rows]
        plan.build("SM_Beam", *(PropPiece(wood("Walnut"), beam) for beam in beams))
    pitch = 2.4 if building.ceiling == "panels" else 2.9
    columns, rows_ = max(1, round(area.width / pitch)), max(1, round(area.depth / pitch))
    pieces: list[PropPiece] = []
    for column in range(columns):
        for row in range(rows_):
            x = area.x0 + (column + 0.5) * area.width / columns
            y = area.y0 + (row + 0.5) * area.depth / rows_
            pieces += _panel_lamp(x, y, top) if building.ceiling == "panels" else _round_lamp(x, y, top)
    plan.build("SM_CeilingLight", *pieces)


def _panel_lamp(x: float, y: float, top: float) -> list[PropPiece]:
    z = top - 0.032
    glass = quad([(x - 0.55, y + 0.28, z), (x + 0.55, y + 0.28, z), (x + 0.55, y - 0.28, z), (x - 0.55, y - 0.28, z)])
    return [
        PropPiece(LAMP_RIM, block((x - 0.6, y - 0.32, top - 0.03), (x + 0.6, y + 0.32, top))),
        PropPiece(LAMP, glass),
    ]


def _round_lamp(x: float, y: float, top: float) -> list[PropPiece]:
    """A pendant: rose, cord and a flat glass drum, whose lower face lights the room."""
    rose = lathe([(0.05, top - 0.03), (0.06, top)], (x, y), 8)
    cord = lathe([(0.006, top - 0.24), (0.006, top - 0.03)], (x, y), 4)
    shade = lathe([(0.30, top - 0.34), (0.28, top - 0.24)], (x, y), 12)
    return [PropPiece(PLATE, rose), PropPiece(LAMP_RIM, cord), PropPiece(glowing("LampGlass", "#fff4de"), shade)]


def _hang_windows(plan: FloorPlan, room: BuiltRoom, building: BuildingLook) -> None:
    look = building.looks[room.kind]
    for side in room.outer:
        model = plan.props.model("SM_WindowHome", building.views[side in "NE"])
        length = room.area.width if side in "NS" else room.area.depth
        count = min(look.windows, int(length // 2.6))
        for index in range(count):
            share = (index + 0.5) / count
            x = {"W": room.area.x0, "E": room.area.x1}.get(side, room.area.x0 + share * room.area.width)
            y = {"S": room.area.y0, "N": room.area.y1}.get(side, room.area.y0 + share * room.area.depth)
            plan.add(model, x, y, FACING[side])
            if look.curtain is not None:
                plan.add(plan.props.model("SM_Drape", look.curtain), x, y, FACING[side])


def rug(plan: FloorPlan, area: Rectangle, name: str) -> None:
    """Adds a rug that shows its whole pattern, 3 mm high, so that it is not an obstacle."""
    cover = SurfaceMaterial(name, "#a08a70", name, roughness=0.95)
    low, high = (area.x0, area.y0, 0.0), (area.x1, area.y1, 0.003)
    plan.build("SM_Rug", PropPiece(cover, open_block(low, high, "T", fitted=True)))
