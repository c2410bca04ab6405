"""The plan of a scene under construction: structures, props and the free floor between them.

Keeps door zones and furniture footprints apart, as axis-aligned rectangles in metres; never renders or writes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from numpy.random import Generator

from factory.scenes.author.materials import PropPiece
from factory.scenes.author.props.catalogue import PropModel, Workshop

__all__ = ["FACING", "FloorPlan", "PropPlacement", "Rectangle", "Structure", "wall_pose"]

FACING = {"N": 0.0, "E": -math.pi / 2, "S": math.pi, "W": math.pi / 2}
"""Yaw in radians of a prop whose back is to that wall; at yaw 0 a prop faces -y, its back is to the north."""

SMALL_HALF_WIDTH_M = 0.3
SMALL_STANDOFF_M = 0.30
"""Small things stand with their centre this far from a wall, so that a robot may come along the wall."""


class Rectangle(NamedTuple):
    """An axis-aligned piece of floor, metres."""

    x0: float
    y0: float
    x1: float
    y1: float

    @property
    def width(self) -> float:
        """Extent along x."""
        return self.x1 - self.x0

    @property
    def depth(self) -> float:
        """Extent along y."""
        return self.y1 - self.y0

    @property
    def centre(self) -> tuple[float, float]:
        """Middle point."""
        return (self.x0 + self.x1) / 2, (self.y0 + self.y1) / 2

    def grown(self, margin: float) -> Rectangle:
        """The rectangle with `margin` metres added on every side."""
        return Rectangle(self.x0 - margin, self.y0 - margin, self.x1 + margin, self.y1 + margin)

    def overlaps(self, other: Rectangle) -> bool:
        """Whether the interiors meet."""
        return self.x0 < other.x1 and other.x0 < self.x1 and self.y0 < other.y1 and other.y0 < self.y1

    def contains(self, other: Rectangle) -> bool:
        """Whether the other lies inside, up to a millimetre."""
        eps = 1e-3
        return (
            self.x0 - eps <= other.x0
            and self.y0 - eps <= other.y0
            and other.x1 <= self.x1 + eps
            and other.y1 <= self.y1 + eps
        )


@dataclass(frozen=True)
class Structure:
    """A part of the building: prim name and pieces in world metres."""

    name: str
    pieces: tuple[PropPiece, ...]


@dataclass(frozen=True)
class PropPlacement:
    """One prop in the world: unique prim name, model, position in metres and yaw in radians."""

    name: str
    model: PropModel
    x: float
    y: float
    z: float
    yaw: float


@dataclass
class FloorPlan:
    """A scene while it is being laid out; placements that do not fit are refused, not forced."""

    seed: int
    rng: Generator
    workshop: Workshop = field(init=False)
    structures: list[Structure] = field(default_factory=list)
    placements: list[PropPlacement] = field(default_factory=list)
    taken: list[Rectangle] = field(default_factory=list)
    kept_clear: list[Rectangle] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.workshop = Workshop(self.seed)

    def build(self, name: str, *pieces: PropPiece) -> None:
        """Adds a part of the building under a numbered name."""
        self.structures.append(Structure(f"{name}_{len(self.structures):03d}", pieces))

    def keep_clear(self, zone: Rectangle) -> None:
        """Forbids furniture on a piece of floor, such as a door's swing."""
        self.kept_clear.append(zone)

    def pick(self, count: int) -> int:
        """A random variant number below `count`."""
        return int(self.rng.integers(count))

    def add(self, model: PropModel, x: float, y: float, yaw: float, z: float = 0.0) -> PropPlacement:
        """Places a model without asking for room: on desks, on walls, under ceilings."""
        placement = PropPlacement(f"{model.name}_{len(self.placements)}", model, x, y, z, yaw)
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
            model: what to place.
            x: position of the model's origin, metres.
            y: the same along y.
            yaw: heading in radians, counter-clockwise.
            room: rectangle the footprint must lie in, or None.
            clearance: metres to keep to other furniture.
            share: True for things that may touch furniture, such as chairs under a table; doors still count.

        Returns:
            The placement, or None when it would stand in the way.
        """
        print_ = footprint(model, x, y, yaw)
        if room is not None and not room.contains(print_):
            return None
        if any(print_.overlaps(zone) for zone in self.kept_clear):
            return None
        if not share and any(print_.grown(clearance).overlaps(other) for other in self.taken):
            return None
        self.taken.append(print_)
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
            model: what to place.
            room: free rectangle between the walls.
            side: N, E, S or W.
            along: 0 to 1 from the west or south end of that wall.
            clearance: metres to keep to other furniture.
            gap: metres between wall and back.
        """
        x, y, yaw = wall_pose(model, room, side, along, gap)
        return self.place(model, x, y, yaw, None, clearance)

    def against_somewhere(
        self, model: PropModel, room: Rectangle, sides: str, clearance: float = 0.1, tries: int = 12
    ) -> PropPlacement | None:
        """Like `against`, trying random places along random ones of the given sides."""
        for _ in range(tries):
            side = sides[self.pick(len(sides))]
            found = self.against(model, room, side, float(self.rng.uniform(0.04, 0.96)), clearance)
            if found:
                return found
        return None

    def hang(self, model: PropModel, room: Rectangle, side: str, along: float) -> PropPlacement | None:
        """Hangs a model on a wall, beside what is already there; None when no free stretch is found."""
        for _ in range(6):
            x, y, yaw = wall_pose(model, room, side, along, 0.0)
            if not self._meets_anything(model, x, y, yaw):
                return self.add(model, x, y, yaw)
            along = float(self.rng.uniform(0.05, 0.95))
        return None

    def _meets_anything(self, model: PropModel, x: float, y: float, yaw: float) -> bool:
        """Whether the turned model's box, with 5 cm around it, meets any placed model's box."""
        print_ = footprint(model, x, y, yaw).grown(0.05)
        return any(
            other.model.low[2] + other.z < model.high[2]
            and model.low[2] < other.model.high[2] + other.z
            and print_.overlaps(footprint(other.model, other.x, other.y, other.yaw))
            for other in self.placements
        )

    def in_corner(self, model: PropModel, room: Rectangle, corner: int, clearance: float = 0.1) -> PropPlacement | None:
        """Places a model in corner 0 SW, 1 SE, 2 NW or 3 NE of a room."""
        reach = float(max(model.high[0], -model.low[0], model.high[1], -model.low[1], 0.3)) + 0.04
        x = room.x1 - reach if corner & 1 else room.x0 + reach
        y = room.y1 - reach if corner & 2 else room.y0 + reach
        return self.place(model, x, y, 0.0, None, clearance)

    def in_some_corner(self, model: PropModel, room: Rectangle, clearance: float = 0.55) -> PropPlacement | None:
        """Places a model in the first of the four corners, in random order, that is free."""
        for corner in self.rng.permutation(4):
            found = self.in_corner(model, room, int(corner), clearance)
            if found:
                return found
        return None

    def top_up(self, name: str, minimum: int, areas: Sequence[Rectangle], sides: str = "EW") -> None:
        """Adds models against walls, ever closer to other furniture, until `minimum` of them stand.

        Args:
            name: catalogue name; every addition draws its own variant.
            minimum: how many the scene must have.
            areas: rooms to try, each in random order.
            sides: walls to use.
        """
        standing = sum(placement.model.name.startswith(name) for placement in self.placements)
        for clearance in (0.3, 0.1, 0.02):
            for room in self.rng.permutation(len(areas)):
                if standing >= minimum:
                    return
                model = self.workshop.model(name, self.pick(12))
                standing += self.against_somewhere(model, areas[room], sides, clearance) is not None


def footprint(model: PropModel, x: float, y: float, yaw: float) -> Rectangle:
    """The axis-aligned rectangle a turned model covers, metres."""
    c, s = math.cos(yaw), math.sin(yaw)
    corners = [(a, b) for a in (model.low[0], model.high[0]) for b in (model.low[1], model.high[1])]
    xs = [x + c * a - s * b for a, b in corners]
    ys = [y + s * a + c * b for a, b in corners]
    return Rectangle(min(xs), min(ys), max(xs), max(ys))


def wall_pose(model: PropModel, room: Rectangle, side: str, along: float, gap: float) -> tuple[float, float, float]:
    """Position and yaw that put a model's back to a wall, at `along` 0..1 of what is left of the wall."""
    half = float(max(model.high[0], -model.low[0]))
    back = float(model.high[1]) + gap
    if gap > 0.0 and half < SMALL_HALF_WIDTH_M and model.low[2] < 0.1:  # what hangs, hangs on the wall
        back = max(back, SMALL_STANDOFF_M)
    if side in "NS":
        x = room.x0 + half + along * max(room.width - 2 * half, 0.0)
        return x, (room.y1 - back if side == "N" else room.y0 + back), FACING[side]
    y = room.y0 + half + along * max(room.depth - 2 * half, 0.0)
    return (room.x1 - back if side == "E" else room.x0 + back), y, FACING[side]
