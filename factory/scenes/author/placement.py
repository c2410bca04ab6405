"""Floor plan of a scene during authoring: structures, props and free floor.

Keeps door zones and furniture footprints disjoint, as axis-aligned rectangles in metres. Does not write USD.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from factory.scenes.author.materials import PropPiece
from factory.scenes.author.props.catalogue import PropBuilder, PropModel
from schemas.support.numpy_types import Floats

FACING = {"N": 0.0, "E": -math.pi / 2, "S": math.pi, "W": math.pi / 2}
"""Wall -> yaw of a prop with its back to that wall, radians. At yaw 0 a prop faces -y, with its back to the north."""

MOST_INTO_M = 0.01
"""Permitted depth by which a part of a seat reaches into a part of its table, metres."""
_MOST_ASIDE_M = 0.02
"""Permitted depth by which a thing on furniture reaches into another prop, such as the frame of a window, metres."""
_STEP_BACK_M, _MOST_BACK_M = 0.02, 0.16
"""A seat that would reach into its table stands this far behind its place, in steps, metres."""
_VIEW_M = 0.5
"""Depth of the space before a window, board, screen or picture that furniture should leave free, metres."""
_FLOOR_M, _LOW_M = 0.002, 0.07
"""A standing prop whose lowest point is between these heights is moved down to the floor, metres."""
_MOST_HIDDEN = 0.15
"""Largest share of its front that furniture may hide."""
_LOOKED_AT = (
    "SM_Window", "SM_Whiteboard", "SM_Television", "SM_Picture", "SM_Poster", "SM_WallMap", "SM_PinBoard",
    "SM_Tapestry", "SM_Mirror", "SM_ClockWall",
)  # fmt: skip
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

    def without(self, other: Rectangle) -> list[Rectangle]:
        """Returns up to four rectangles that cover this rectangle except for the other."""
        if not self.overlaps(other):
            return [self]
        y0, y1 = max(self.y0, other.y0), min(self.y1, other.y1)
        parts = (
            self._replace(y1=y0), self._replace(y0=y1),
            Rectangle(self.x0, y0, other.x0, y1), Rectangle(other.x1, y0, self.x1, y1),
        )  # fmt: skip
        return [part for part in parts if part.width > 1e-6 and part.depth > 1e-6]

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
    def is_looked_at(self) -> bool:
        """Whether furniture should not hide it."""
        return self.model.name.startswith(_LOOKED_AT)

    @cached_property
    def heights(self) -> tuple[float, float]:
        """Heights of its lowest and highest point, metres."""
        return float(self.model.low[2]) + self.z, float(self.model.high[2]) + self.z


class PieceBox(NamedTuple):
    """Upright box around a piece: its corners in the frame of its prop, and the pose of the prop."""

    low: Floats
    high: Floats
    placement: PropPlacement


def solids(placement: PropPlacement) -> list[PieceBox]:
    """Returns the boxes of the pieces of a prop."""
    return [PieceBox(low, high, placement) for low, high in placement.model.boxes]


def penetration(one: PieceBox, two: PieceBox) -> float:
    """Returns the depth by which two upright boxes intersect, metres; 0 or less if they do not intersect.

    The depth is the smallest of the overlaps along the height and along the horizontal sides of both boxes.
    """
    z = min(one.high[2] + one.placement.z, two.high[2] + two.placement.z) - max(
        one.low[2] + one.placement.z, two.low[2] + two.placement.z
    )
    return float(z) if z <= 0.0 else min(float(z), *(_overlap(a, b) for a, b in ((one, two), (two, one))))


def _overlap(frame: PieceBox, other: PieceBox) -> float:
    """Returns the smaller of the overlaps along the two horizontal sides of the first box, metres."""
    (x0, y0), (x1, y1) = other.low[:2], other.high[:2]
    corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)]) @ _turn(other.placement.yaw)
    place = (other.placement.x - frame.placement.x, other.placement.y - frame.placement.y)
    corners = (corners + place) @ _turn(-frame.placement.yaw)
    low, high = corners.min(axis=0), corners.max(axis=0)
    return float(np.min(np.minimum(frame.high[:2], high) - np.maximum(frame.low[:2], low)))


def _turn(yaw: float) -> Floats:
    """Returns the (2, 2) matrix that turns row vectors by `yaw` radians, counter-clockwise."""
    return np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])


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
    covered: list[Rectangle] = field(default_factory=list)
    """Floor under rugs and markings, so no two of them share a plane."""

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
        """Places a seat, which may touch only the piece of furniture `of`; returns `None` if it does not fit.

        A seat whose legs or arm rests would reach into parts of the furniture stands a little behind its place.
        """
        back = 0.0
        while back <= _MOST_BACK_M:
            at = (x - back * math.sin(yaw), y + back * math.cos(yaw))
            seat = solids(PropPlacement("", model, x=at[0], y=at[1], z=0.0, yaw=yaw))
            if all(penetration(part, other) <= MOST_INTO_M for part in seat for other in solids(of)):
                print_ = footprint(model, *at, yaw)
                if any(print_.overlaps(other) for other in self.taken if other != of.floor_box):
                    return None
                return self.place(model, *at, yaw, room, 0.0, True)
            back += _STEP_BACK_M
        return None

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
            pose = wall_pose(model, room, side=side, along=along, gap=0.03)
            if avoid and (self.meets(model, *pose, 0.0) or self.hides(model, *pose)):
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
        return None if self.meets(model, x, y, yaw) or self.hides(model, x, y, yaw) else self.add(model, x, y, yaw)

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

    def intersects(self, model: PropModel, x: float, y: float, yaw: float, z: float, but: PropPlacement) -> bool:
        """Returns whether a model at a pose would reach into a placed prop other than `but`, by its boxes."""
        new = PropPlacement("", model, x=x, y=y, z=z, yaw=yaw)
        near = (other for other in self.placements if other is not but and other.floor_box.overlaps(new.floor_box))
        return any(penetration(a, b) > _MOST_ASIDE_M for other in near for a in solids(new) for b in solids(other))

    def hides(self, model: PropModel, x: float, y: float, yaw: float) -> bool:
        """Returns whether a model at a pose would hide a window, board, screen or picture, or is one and hidden."""
        new = PropPlacement("", model, x=x, y=y, z=0.0, yaw=yaw)
        near = new.floor_box.grown(_VIEW_M)
        return any(
            (other.is_looked_at and hidden_share(other, new) > _MOST_HIDDEN)
            or (new.is_looked_at and hidden_share(new, other) > _MOST_HIDDEN)
            for other in self.placements
            if (new.is_looked_at or other.is_looked_at) and near.overlaps(other.floor_box)
        )

    def in_corner(
        self, model: PropModel, room: Rectangle, corner: int, clearance: float = 0.1, avoid: bool = False
    ) -> PropPlacement | None:
        """Places a model in corner 0 SW, 1 SE, 2 NW or 3 NE of a room; `avoid` as for `against_somewhere`."""
        reach = float(max(model.high[0], -model.low[0], model.high[1], -model.low[1], 0.3)) + 0.04
        x = room.x1 - reach if corner & 1 else room.x0 + reach
        y = room.y1 - reach if corner & 2 else room.y0 + reach
        if avoid and (self.meets(model, x, y=y, yaw=0.0, margin=0.0) or self.hides(model, x, y, 0.0)):
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


def hidden_share(wall_object: PropPlacement, by: PropPlacement) -> float:
    """Returns the share of the front of an object at a wall that another prop hides within `_VIEW_M` metres, 0..1."""
    left, front, right = (
        float(wall_object.model.low[0]),
        float(wall_object.model.low[1]),
        float(wall_object.model.high[0]),
    )
    at = (by.x - wall_object.x, by.y - wall_object.y)
    (x0, y0), (x1, y1) = by.model.low[:2].tolist(), by.model.high[:2].tolist()
    corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)]) @ _turn(by.yaw) + at
    corners = corners @ _turn(-wall_object.yaw)
    low, high = corners.min(axis=0), corners.max(axis=0)
    if low[1] >= front or high[1] <= front - _VIEW_M:
        return 0.0
    (bottom, top), (low_z, high_z) = wall_object.heights, by.heights
    across, up = min(right, high[0]) - max(left, low[0]), min(top, high_z) - max(bottom, low_z)
    return max(float(across), 0.0) / (right - left) * max(up, 0.0) / (top - bottom)


def settled(plan: FloorPlan) -> list[PropPlacement]:
    """Returns the placements, with standing props and what lies on them moved down so that they touch the floor."""
    drops = {
        number: gap
        for number, piece in enumerate(plan.placements)
        if piece.z == 0.0 and _FLOOR_M < (gap := float(piece.model.low[2])) < _LOW_M
    }
    moved = []
    for number, piece in enumerate(plan.placements):
        carriers = (drops[k] for k in drops if piece.z > 0.0 and _is_on(piece, plan.placements[k]))
        drop = drops.get(number) or next(carriers, 0.0)
        moved.append(replace(piece, z=piece.z - drop) if drop else piece)
    return moved


def _is_on(thing: PropPlacement, piece: PropPlacement) -> bool:
    box = piece.floor_box
    return box.x0 < thing.x < box.x1 and box.y0 < thing.y < box.y1 and thing.z <= piece.heights[1] + _LOW_M


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
