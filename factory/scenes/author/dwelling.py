"""Builds the rooms of a divided floor: floors, walls with doors, ceilings with lamps, windows with curtains.

Does not divide the floor and does not furnish.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

from factory.scenes.author.geometry import AuthoredMesh, block, open_block
from factory.scenes.author.materials import PropPiece, SurfaceMaterial, painted
from factory.scenes.author.partition import Division, Opening
from factory.scenes.author.placement import FACING, FloorPlan, Rectangle, RoomRecord
from factory.scenes.author.room import DOOR_CLEARANCE_M, WALL_THICKNESS_M, Trim, build_ceiling, floor, wall

_SIDES = "SNWE"
GRIP = painted("Steel", 0.35, 1.0)


class RoomLook(NamedTuple):
    """Look of a kind of room: floor, walls, window view and curtain; a room without windows has `windows` 0."""

    floor: SurfaceMaterial
    paint: SurfaceMaterial
    windows: int = 2
    """Largest number of windows in a wall."""
    curtain: int | None = None
    """Variant of the curtains, or `None` for none."""
    window: str = "SM_WindowHome"
    """Model of the windows."""
    window_pitch_m: float = 2.6
    """Least length of wall for each window, metres."""
    trim: Trim | None = None
    """Trim of the walls, or `None` for that of the building."""
    ceiling: str = ""
    """Ceiling; empty for that of the building."""
    height: float | None = None
    """Height of the ceiling, metres; `None` for that of the building."""


@dataclass(frozen=True)
class BuildingLook:
    """Look of a building.

    Attributes:
        looks: look by kind of room.
        trim: trim of the walls.
        leaf: material of the door leaves.
        ceiling: style of the ceilings, see `build_ceiling`.
        views: variant of the windows to the south and west, and variant of the windows to the north and east.
        height: height of the walls and of the ceilings, metres.
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
    outside: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    """Parts of the sides that are outer walls, by side: start and end between the wall faces, metres."""
    doors: dict[str, list[float]] = field(default_factory=dict)
    """Centres of the openings by side, metres."""
    joints: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    """Start and end of the openings without a wall, by side, metres."""
    neighbours: list[int] = field(default_factory=list)

    def has_wall(self, side: str, at: float, margin: float) -> bool:
        """Returns whether a side has no joint within `margin` metres of a position; at a joint, there is no wall."""
        return not any(low - margin < at < high + margin for low, high in self.joints.get(side, ()))


def build_rooms(plan: FloorPlan, division: Division, building: BuildingLook) -> list[BuiltRoom]:
    """Adds the structures of all rooms and returns the rooms."""
    rooms = _built_rooms(division)
    for room, area in zip(rooms, division.areas, strict=True):
        look = building.looks[room.kind]
        floor(plan, area, look.floor)
        build_ceiling(plan, area, look.ceiling or building.ceiling, look.height or building.height)
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
    rooms = [
        BuiltRoom(number, spec.kind, area.grown(-WALL_THICKNESS_M / 2))
        for number, (spec, area) in enumerate(zip(division.specs, division.areas, strict=True))
    ]
    for run in _wall_runs(division.areas):
        inside = run.above if run.below is None else run.below
        if inside is not None and None in (run.below, run.above):
            side = ("SN" if run.is_along_x else "WE")[run.above is None]
            span = (run.span[0] + WALL_THICKNESS_M / 2, run.span[1] - WALL_THICKNESS_M / 2)
            rooms[inside].outside.setdefault(side, []).append(span)
    for room in rooms:
        room.outside = {side: room.outside[side] for side in _SIDES if side in room.outside}
    for opening in division.openings:
        for inner, other in (opening.rooms, opening.rooms[::-1]):
            area = division.areas[inner]
            ahead = abs(opening.at - (area.y1 if opening.is_along_x else area.x1)) < 1e-6
            side = ("SN" if opening.is_along_x else "WE")[ahead]
            centre, half = opening.doorway.centre, opening.doorway.width / 2
            rooms[inner].doors.setdefault(side, []).append(centre)
            if opening.is_joint:
                rooms[inner].joints.setdefault(side, []).append((centre - half, centre + half))
            rooms[inner].neighbours.append(other)
    return rooms


class _Run(NamedTuple):
    """Straight wall between two rooms, or between a room and the outside, which is `None`."""

    is_along_x: bool
    at: float
    span: tuple[float, float]
    below: int | None
    above: int | None


def _wall_runs(areas: Sequence[Rectangle]) -> Iterator[_Run]:
    """Yields all walls; a wall ends where the room on one of its sides changes."""
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
    """Builds a wall with its doors. Between two parts of a hall, builds nothing and only keeps the floor clear."""
    openings = [opening for opening in division.openings if _is_in(opening, run)]
    if any(opening.is_joint for opening in openings):
        low, high = run.span
        near, far = run.at - DOOR_CLEARANCE_M, run.at + DOOR_CLEARANCE_M
        plan.keep_clear(Rectangle(low, near, high, far) if run.is_along_x else Rectangle(near, low, far, high))
        return
    looks = [None if room is None else building.looks[division.specs[room].kind] for room in (run.below, run.above)]
    shown = next(look for look in looks if look is not None)
    faces = tuple((look or shown).paint for look in looks)
    trims = tuple(None if look is None else look.trim or building.trim for look in looks)
    doors = [opening.doorway for opening in openings]
    wall(
        plan,
        run.is_along_x,
        at=run.at,
        span=run.span,
        faces=(faces[0], faces[1]),
        doors=doors,
        height=building.height,
        trims=(trims[0], trims[1]),
    )


def _is_in(opening: Opening, run: _Run) -> bool:
    return (
        opening.is_along_x == run.is_along_x
        and abs(opening.at - run.at) < 1e-5
        and run.span[0] < opening.doorway.centre < run.span[1]
    )


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


def _hang_windows(plan: FloorPlan, room: BuiltRoom, building: BuildingLook) -> None:
    look = building.looks[room.kind]
    for side, spans in room.outside.items():
        model = plan.props.model(look.window, building.views[side in "NE"])
        for low, high in spans:
            count = min(look.windows, int((high - low) // look.window_pitch_m))
            for index in range(count):
                along = low + (index + 0.5) / count * (high - low)
                x = {"W": room.area.x0, "E": room.area.x1}.get(side, along)
                y = {"S": room.area.y0, "N": room.area.y1}.get(side, along)
                plan.add(model, x, y, FACING[side])
                if look.curtain is not None:
                    plan.add(plan.props.model("SM_Drape", look.curtain), x, y, FACING[side])


def rug(plan: FloorPlan, area: Rectangle, name: str) -> None:
    """Adds a rug that shows its whole pattern, 3 mm high, so it is not an obstacle."""
    cover = SurfaceMaterial(name, "#a08a70", name, roughness=0.95)
    low, high = (area.x0, area.y0, 0.0), (area.x1, area.y1, 0.003)
    plan.covered.append(area)
    plan.build("SM_Rug", PropPiece(cover, open_block(low, high, "T", fitted=True)))
