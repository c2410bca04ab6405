"""Floor plan of a scene during authoring: structures, props and free floor.

Keeps door zones and furniture footprints disjoint, as axis-aligned rectangles in metres. Does not write USD.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

from numpy.random import Generator

from factory.scenes.author.materials import PropPiece
from factory.scenes.author.props.catalogue import PropBuilder, PropModel

FACING = {"N": 0.0, "E": -math.pi / 2, "S": math.pi, "W": math.pi / 2}
"""Wall -> yaw of a prop with its back to that wall, radians. At yaw 0 a prop faces -y, with its back to the north."""

SMALL_HALF_WIDTH_M = 0.3
SMALL_STANDOFF_M = 0.30
"""Distance of the centre of small props from a wall, metres, so the robot can drive along the wall."""


class Rectangle(NamedTuple):
    """Axis-aligned rectangle on the floor, metres."""

    x0: float
    y0: float
    x1: float
    y1: float

    @property
    def width(self) -> float:
        """Extent along x, metres."""
        return self.x1 - self.x0

    @property
    def depth(self) -> float:
        """Extent along y, metres."""
        return self.y1 - self.y0

    @property
    def centre(self) -> tuple[float, float]:
        """Centre x, y, metres."""
        return (self.x0 + self.x1) / 2, (self.y0 + self.y1) / 2

    def grown(self, margin: float) -> Rectangle:
        """Returns the rectangle with `margin` metres added on every side."""
        return Rectangle(self.x0 - margin, self.y0 - margin, self.x1 + margin, self.y1 + margin)

    def overlaps(self, other: Rectangle) -> bool:
        """Returns whether the interiors intersect."""
        return self.x0 < other.x1 and other.x0 < self.x1 and self.y0 < other.y1 and other.y0 < self.y1

    def contains(self, other: Rectangle) -> bool:
        """Returns whether the other rectangle is inside, with a tolerance of a millimetre."""
        eps = 1e-3
        return (
            self.x0 - eps <= other.x0
            and self.y0 - eps <= other.y0
            and other.x1 <= self.x1 + eps
            and other.y1 <= self.y1 + eps
        )


@dataclass(frozen=True)
class Structure:
    """Part of the building: prim name and pieces in world metres."""

    name: str
    pieces: tuple[PropPiece, ...]


@dataclass(frozen=True)
class PropPlacement:
    """Placed prop: unique prim name, model, position in metres and yaw in radians."""

    name: str
    model: PropModel
    x: float
    y: float
    z: float
    yaw: float

    @cached_property
    def floor_box(self) -> Rectangle:
        """Axis-aligned footprint, metres."""
        return footprint(self.model, self.x, self.y, self.yaw)

    @cached_property
    def heights(self) -> tuple[float, float]:
        """Heights of its lowest and highest point, metres."""
        return float(self.model.low[2]) + self.z, float(self.model.high[2]) + self.z


class RoomRecord(NamedTuple):
    """Room of a layout, for statistics: use, floor between the wall faces, numbers of the rooms behind its doors."""

    kind: str
    area: Rectangle
    neighbours: tuple[int, ...]


@dataclass
class FloorPlan:
    """Scene during authoring. Placements that do not fit are rejected."""

    seed: int
    rng: Generator
    props: PropBuilder = field(init=False)
    structures: list[Structure] = field(default_factory=list)
    placements: list[PropPlacement] = field(default_factory=list)
    taken: list[Rectangle] = field(default_factory=list)
    kept_clear: list[Rectangle] = field(default_factory=list)
    rooms: list[RoomRecord] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.props = PropBuilder(self.seed)

    def build(self, name: str, *pieces: PropPiece) -> None:
        """Adds a part of the building under a numbered name."""
        self.structures.append(Structure(f"{name}_{len(self.structures):03d}", pieces))

    def keep_clear(self, zone: Rectangle) -> None:
        """Excludes a rectangle of the floor from furniture, such as the zone of a door."""
        self.kept_clear.append(zone)

    def pick(self, count: int) -> int:
        """Returns a random variant number below `count`."""
        return int(self.rng.integers(count))

    def add(self, model: PropModel, x: float, y: float, yaw: float, z: float = 0.0) -> PropPlacement:
        """Places a model without a collision test: on desks, on walls, under ceilings."""
        placement = PropPlacement(f"{model.name}_{len(self.placements)}", model, x=x, y=y, z=z, yaw=yaw)
        self.placements.append(placement)
        return placement

    def place(
        self,
        model: PropModel,
        x: float,
        y: float,
        yaw: float,
        room: Rectangle | None = None,
        clearance: float = 0.05,
        share: bool = False,
    ) -> PropPlacement | None:
        """Places a model on the floor if its footprint fits.

        Args:
            model: model to place.
            x: x of the model's origin, metres.
            y: y of the model's origin, metres.
            yaw: heading, radians, counter-clockwise.
            room: rectangle that must contain the footprint, or None.
            clearance: minimum distance to other furniture, metres.
            share: whether the model may touch furniture, such as a chair under a table; door zones still apply.

        Returns:
            The placement, or None if the footprint does not fit.
        """
        print_ = footprint(model, x, y, yaw)
        if room is not None and not room.contains(print_):
            return None
        if any(print_.overlaps(zone) for zone in self.kept_clear):
            return None
        wide = print_.grown(clearance)
        if not share and any(wide.overlaps(other) for other in self.taken):
            return None
        return self.stand(model, x, y, yaw)

    def seat(
        self, model: PropModel, x: float, y: float, yaw: float, room: Rectangle, of: PropPlacement
    ) -> PropPlacement | None:
        """Places a seat, which may touch only the piece of furniture `of`; returns `None` if it does not fit."""
        print_ = footprint(model, x, y, yaw)
        if any(print_.overlaps(other) for other in self.taken if other != of.floor_box):
            return None
        return self.place(model, x, y, yaw, room, 0.0, True)

    def stand(self, model: PropModel, x: float, y: float, yaw: float) -> PropPlacement:
        """Places a model on the floor without a collision test, and marks its footprint as occupied."""
        self.taken.append(footprint(model, x, y, yaw))
        return self.add(model, x, y, yaw)

    def against(
        self,
        model: PropModel,
        room: Rectangle,
        side: str,
        along: float,
        clearance: float = 0.1,
        gap: float = 0.03,
    ) -> PropPlacement | None:
        """Places a model with its back to a wall of the room.

        Args:
            model: model to place.
            room: free rectangle between the walls.
            side: side of the wall: N, E, S or W.
            along: position along the wall, 0..1 from its west or south end.
            clearance: minimum distance to other furniture, metres.
            gap: distance between wall and back, metres.
        """
        x, y, yaw = wall_pose(model, room, side=side, along=along, gap=gap)
        return self.place(model, x, y, yaw, None, clearance)

    def against_somewhere(
        self,
        model: PropModel,
        room: Rectangle,
        sides: str,
        clearance: float = 0.1,
        tries: int = 12,
        avoid: bool = False,
    ) -> PropPlacement | None:
        """Calls `against` with random positions along random walls of the given sides until a placement fits.

        With `avoid`, the model also keeps clear of things on the walls, such as curtains and window sills.
        """
        for _ in range(tries):
            side = sides[self.pick(len(sides))]
            along = float(self.rng.uniform(0.04, 0.96))
            if avoid and self.meets(model, *wall_pose(model, room, side=side, along=along, gap=0.03), 0.0):
                continue
            placed = self.against(model, room, side=side, along=along, clearance=clearance)
            if placed:
                return placed
        return None

    def hang(self, model: PropModel, room: Rectangle, side: str, along: float) -> PropPlacement | None:
        """Mounts a model on a wall beside other models, or returns None if no free section is found."""
        for _ in range(6):
            x, y, yaw = wall_pose(model, room, side=side, along=along, gap=0.0)
            if not self.meets(model, x, y, yaw):
                return self.add(model, x, y, yaw)
            along = float(self.rng.uniform(0.05, 0.95))
        return None

    def hang_at(self, model: PropModel, x: float, y: float, yaw: float) -> PropPlacement | None:
        """Mounts a model at a pose, or returns None if it meets another model."""
        return None if self.meets(model, x, y, yaw) else self.add(model, x, y, yaw)

    def is_free_strip(self, room: Rectangle, side: str, start: float, length: float, depth: float) -> bool:
        """Returns whether a strip of floor along a wall, `depth` metres deep, is free from `start` on."""
        a, b = (room.x0, room.y0) if side in "NS" else (room.y0, room.x0)
        across = {"N": (room.y1 - depth, room.y1), "E": (room.x1 - depth, room.x1)}.get(side, (b, b + depth))
        low, high = (a + start, across[0]), (a + start + length, across[1])
        strip = Rectangle(*low, *high) if side in "NS" else Rectangle(low[1], low[0], high[1], high[0])
        return not any(strip.overlaps(other) for other in (*self.kept_clear, *self.taken))

    def meets(self, model: PropModel, x: float, y: float, yaw: float, margin: float = 0.05) -> bool:
        """Returns whether the rotated box of the model, with a margin in metres, intersects that of a placed model."""
        x0, y0, x1, y1 = footprint(model, x, y, yaw).grown(margin)
        low, high = float(model.low[2]), float(model.high[2])
        for other in self.placements:  # `overlaps` is inlined: thousands of calls loop over hundreds of placements
            left, front, right, back = other.floor_box
            if x0 < right and left < x1 and y0 < back and front < y1:
                bottom, top = other.heights
                if bottom < high and low < top:
                    return True
        return False

    def in_corner(
        self, model: PropModel, room: Rectangle, corner: int, clearance: float = 0.1, avoid: bool = False
    ) -> PropPlacement | None:
        """Places a model in corner 0 SW, 1 SE, 2 NW or 3 NE of a room; `avoid` as for `against_somewhere`."""
        reach = float(max(model.high[0], -model.low[0], model.high[1], -model.low[1], 0.3)) + 0.04
        x = room.x1 - reach if corner & 1 else room.x0 + reach
        y = room.y1 - reach if corner & 2 else room.y0 + reach
        if avoid and self.meets(model, x, y=y, yaw=0.0, margin=0.0):
            return None
        return self.place(model, x, y, 0.0, None, clearance)

    def in_some_corner(
        self, model: PropModel, room: Rectangle, clearance: float = 0.55, avoid: bool = False
    ) -> PropPlacement | None:
        """Places a model in the first of the four corners, in random order, that is free; `avoid` as for
        `against_somewhere`."""
        for corner in self.rng.permutation(4):
            placed = self.in_corner(model, room, corner=int(corner), clearance=clearance, avoid=avoid)
            if placed:
                return placed
        return None

    def top_up(self, name: str, minimum: int, areas: Sequence[Rectangle], sides: str = "EW") -> None:
        """Adds models against walls, with decreasing clearance, until the scene has `minimum` of them.

        Args:
            name: catalogue name; each model has a random variant.
            minimum: minimum number in the scene.
            areas: rooms to try, in random order.
            sides: walls to use.
        """
        standing = sum(placement.model.name.startswith(name) for placement in self.placements)
        for clearance in (0.3, 0.1, 0.02):
            for room in self.rng.permutation(len(areas)):
                if standing >= minimum:
                    return
                model = self.props.model(name, self.pick(12))
                standing += self.against_somewhere(model, areas[room], sides, clearance) is not None


def footprint(model: PropModel, x: float, y: float, yaw: float) -> Rectangle:
    """Returns the axis-aligned footprint of a rotated model, metres."""
    c, s = math.cos(yaw), math.sin(yaw)
    (x0, y0, _), (x1, y1, _) = model.low.tolist(), model.high.tolist()
    corners = [(a, b) for a in (x0, x1) for b in (y0, y1)]
    xs = [x + c * a - s * b for a, b in corners]
    ys = [y + s * a + c * b for a, b in corners]
    return Rectangle(min(xs), min(ys), max(xs), max(ys))


def wall_pose(model: PropModel, room: Rectangle, side: str, along: float, gap: float) -> tuple[float, float, float]:
    """Returns the position and yaw of a model with its back to a wall, at `along`, 0..1, of the usable length."""
    half = float(max(model.high[0], -model.low[0]))
    back = float(model.high[1]) + gap
    if gap > 0.0 and half < SMALL_HALF_WIDTH_M and model.low[2] < 0.1:  # not for wall-mounted models
        back = max(back, SMALL_STANDOFF_M)
    if side in "NS":
        x = room.x0 + half + along * max(room.width - 2 * half, 0.0)
        return x, (room.y1 - back if side == "N" else room.y0 + back), FACING[side]
    y = room.y0 + half + along * max(room.depth - 2 * half, 0.0)
    return (room.x1 - back if side == "E" else room.x0 + back), y, FACING[side]
