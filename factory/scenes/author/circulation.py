"""Arranges halls on a floor, and the blocks of rooms between them: no hall, a straight hall, a T, an L or a ring.

Pure: works on rectangles in metres and a random generator. Does not cut blocks into rooms.

Design: docs/design/scenes.md#halls-are-arranged-before-rooms.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from numpy.random import Generator

from factory.scenes.author.placement import Rectangle

HALL = "hall"
"""Kind of the rooms that are parts of a hall."""
_ROWS = 0.85
SLENDER = 2.1
"""Largest ratio of the sides of a room."""
_SPARE = (1.0, 1.3)
"""Smallest and largest ratio of the floor area of a building to the sum of the desired areas of its rooms. It is at
least 1, because rooms in rows of unsuitable depth become larger than desired."""
_RATIO = (0.75, 1.33)
"""Range of a random factor: width / depth of a building is width / depth of the available floor times this factor."""
_MOST_GROWTH = 1.8
"""Largest ratio of the area of a room in a row to its desired area."""
_MOST_CHANGE = 0.6
"""The widths of the rooms in a row are changed so that the row has the length of its block. If the total change exceeds
this share of the largest change that the limits of the rooms permit, the rooms do not fit."""
_STEPS = 24
"""Number of steps of the bisection that finds the scale of a floor."""


class RoomSpec(NamedTuple):
    """Room of a building program: kind, desired floor area, square metres, and smallest side, metres."""

    kind: str
    area_m2: float
    least_m: float
    is_hub: bool = False
    """Whether the room may have doors to all kinds of rooms; rooms that are not hubs have doors to hubs only."""


Specs = tuple[RoomSpec, ...]


class Block(NamedTuple):
    """Rectangle that is cut into rooms."""

    area: Rectangle
    specs: Specs
    rows: float = 0.0
    """Probability that cuts perpendicular to x, which put rooms side by side along x, are tried first. The value 1
    selects a different method: all rooms form one row along the longer side, and their widths are adapted to the depth
    of the block."""


class Arrangement(NamedTuple):
    """Blocks of rooms, and the parts of the hall between them."""

    blocks: tuple[Block, ...]
    halls: tuple[Rectangle, ...] = ()


class _Areas(NamedTuple):
    """Areas of the blocks and of the parts of the hall."""

    blocks: tuple[Rectangle, ...]
    halls: tuple[Rectangle, ...]


Scheme = Callable[[Generator, Rectangle, Specs], Arrangement | None]
"""Arranges the rooms of a program on a floor, or returns `None` if they do not suit it."""
_Shape = Callable[[float, float], _Areas]
"""Returns the areas for a width and a depth of the floor, metres."""


def no_hall(_rng: Generator, floor: Rectangle, specs: Specs) -> Arrangement:
    """Arranges all rooms in one block."""
    return Arrangement((Block(floor, specs),))


def spine_hall(hall_m: float) -> Scheme:
    """Returns a scheme with a hall along x from wall to wall, and one row of rooms on each side."""

    def draw(rng: Generator) -> _Shape:
        split = float(rng.uniform(0.33, 0.67))

        def areas(width: float, depth: float) -> _Areas:
            y = split * (depth - hall_m)
            return _Areas(
                (Rectangle(0, 0, width, y), Rectangle(0, y + hall_m, width, depth)),
                (Rectangle(0, y, width, y + hall_m),),
            )

        return areas

    return _scaled(draw)


def straight_hall(hall_m: float) -> Scheme:
    """Returns a scheme that fills the floor: a hall along x from wall to wall, and half of the rooms on each side."""

    def arrange(rng: Generator, floor: Rectangle, specs: Specs) -> Arrangement:
        k = len(specs) // 2 + int(rng.integers(len(specs) % 2 + 1))
        share = sum(spec.area_m2 for spec in specs[:k]) / sum(spec.area_m2 for spec in specs)
        y = floor.y0 + share * (floor.depth - hall_m)
        south, north = floor._replace(y1=y), floor._replace(y0=y + hall_m)
        blocks = (Block(south, specs[:k], _ROWS), Block(north, specs[k:], _ROWS))
        return Arrangement(blocks, (floor._replace(y0=y, y1=y + hall_m),))

    return arrange


def t_hall(hall_m: float) -> Scheme:
    """Returns a scheme with a hall along x from wall to wall, and a branch along y to the north."""

    def draw(rng: Generator) -> _Shape:
        split, branch = float(rng.uniform(0.35, 0.55)), float(rng.uniform(0.3, 0.7))

        def areas(width: float, depth: float) -> _Areas:
            y, x = split * (depth - hall_m), branch * (width - hall_m)
            top = y + hall_m
            return _Areas(
                (Rectangle(0, 0, width, y), Rectangle(0, top, x, depth), Rectangle(x + hall_m, top, width, depth)),
                (Rectangle(0, y, width, top), Rectangle(x, top, x + hall_m, depth)),
            )

        return areas

    return _scaled(draw)


def l_hall(hall_m: float) -> Scheme:
    """Returns a scheme with an L-shaped hall in an L-shaped building, with rooms on both sides of the hall."""

    def draw(rng: Generator) -> _Shape:
        south, north = float(rng.uniform(0.24, 0.34)), float(rng.uniform(0.24, 0.34))
        west, east = float(rng.uniform(0.20, 0.30)), float(rng.uniform(0.20, 0.30))

        def areas(width: float, depth: float) -> _Areas:
            y, x = south * (depth - hall_m), west * (width - hall_m)
            top, right = y + hall_m, x + hall_m
            wing_y, wing_x = top + north * (depth - hall_m), right + east * (width - hall_m)
            return _Areas(
                (
                    Rectangle(0, 0, width, y),
                    Rectangle(wing_x, top, width, wing_y),
                    Rectangle(0, top, x, depth),
                    Rectangle(right, top, wing_x, depth),
                ),
                (Rectangle(0, y, width, top), Rectangle(x, top, right, depth)),
            )

        return areas

    return _scaled(draw)


def ring_hall(hall_m: float) -> Scheme:
    """Returns a scheme with a hall around a core of rooms; rooms are to the south and north of the ring, and in most
    buildings also to its west or east."""

    def draw(rng: Generator) -> _Shape:
        south, north = float(rng.uniform(0.28, 0.36)), float(rng.uniform(0.28, 0.36))
        west, east = (float(rng.uniform(0.18, 0.25)) if rng.random() < 0.5 else 0.0 for _ in range(2))

        def areas(width: float, depth: float) -> _Areas:
            free_x, free_y = width - 2 * hall_m, depth - 2 * hall_m
            x0, x1, y0, y1 = west * free_x, width - east * free_x, south * free_y, depth - north * free_y
            core = Rectangle(x0, y0, x1, y1).grown(-hall_m)
            sides = [Rectangle(0, y0, x0, y1), Rectangle(x1, y0, width, y1)]
            return _Areas(
                (
                    Rectangle(0, 0, width, y0),
                    Rectangle(0, y1, width, depth),
                    core,
                    *(side for side in sides if side.width > 0),
                ),
                (
                    Rectangle(x0, y0, x1, core.y0),
                    Rectangle(x0, core.y1, x1, y1),
                    Rectangle(x0, core.y0, core.x0, core.y1),
                    Rectangle(core.x1, core.y0, x1, core.y1),
                ),
            )

        return areas

    return _scaled(draw)


def _scaled(draw: Callable[[Generator], _Shape]) -> Scheme:
    """Returns a scheme that chooses a shape at random, scales it until its blocks have the floor area of the rooms, and
    distributes the rooms to the blocks. The available floor determines only the ratio of the sides and the lower
    corner."""

    def arrange(rng: Generator, floor: Rectangle, specs: Specs) -> Arrangement | None:
        shape, total = draw(rng), sum(spec.area_m2 for spec in specs) * float(rng.uniform(*_SPARE))
        ratio = math.sqrt(floor.width / floor.depth * float(rng.uniform(*_RATIO)))
        low, high = 0.0, 4 * math.sqrt(total)
        for _ in range(_STEPS):
            side = (low + high) / 2
            scheme = shape(side * ratio, side / ratio)
            low, high = (side, high) if _floor_of(scheme.blocks) < total else (low, side)
        dealt = _deal(rng, specs, scheme.blocks)
        if dealt is None:
            return None
        blocks = (
            Block(_moved(area, floor), block_specs, 1.0) for area, block_specs in zip(scheme.blocks, dealt, strict=True)
        )
        return Arrangement(tuple(blocks), tuple(_moved(area, floor) for area in scheme.halls))

    return arrange


def row_widths(area: Rectangle, specs: Specs) -> list[float] | None:
    """Returns the widths of rooms in one row along the longer side of a block, metres; `None` if they do not fit.

    A room has its desired floor area where its smallest side and its proportions permit. The rest of the length is
    added to, or taken from, the widths of all rooms in proportion to how much they can change.
    """
    depth, length = sorted((area.width, area.depth))
    low = [_least_width(spec, depth) for spec in specs]
    if not specs or not all(_suits(spec, depth) for spec in specs):
        return None
    wanted = [_width(spec, depth) for spec in specs]
    spare = length - sum(wanted)
    most = [min(SLENDER * depth, _MOST_GROWTH * spec.area_m2 / depth) for spec in specs]
    ends = [max(end, width) for end, width in zip(most, wanted, strict=True)] if spare > 0 else low
    room = sum(end - width for end, width in zip(ends, wanted, strict=True))
    if abs(spare) > abs(room) * _MOST_CHANGE:
        return None
    return [width + (end - width) * spare / room if room else width for end, width in zip(ends, wanted, strict=True)]


def _suits(spec: RoomSpec, depth: float) -> bool:
    """Returns whether a room fits into a row of a given depth without becoming much larger than desired."""
    return spec.least_m <= depth and _least_width(spec, depth) * depth <= _MOST_GROWTH * spec.area_m2


def _least_width(spec: RoomSpec, depth: float) -> float:
    return max(spec.least_m, depth / SLENDER)


def _width(spec: RoomSpec, depth: float) -> float:
    """Returns the width in metres that gives a room in a row its desired area, changed to a width that its limits
    permit."""
    return min(max(spec.area_m2 / depth, _least_width(spec, depth)), max(SLENDER * depth, spec.least_m))


def _floor_of(areas: Sequence[Rectangle]) -> float:
    """Returns the sum of the areas; 0 if one has no width or depth, because the halls do not fit on the floor."""
    total = 0.0
    for x0, y0, x1, y1 in areas:  # plain loop for speed; it runs thousands of times per floor plan
        width, depth = x1 - x0, y1 - y0
        if width <= 0 or depth <= 0:
            return 0.0
        total += width * depth
    return total


def _moved(area: Rectangle, floor: Rectangle) -> Rectangle:
    return Rectangle(area.x0 + floor.x0, area.y0 + floor.y0, area.x1 + floor.x0, area.y1 + floor.y0)


def _deal(rng: Generator, specs: Specs, areas: Sequence[Rectangle]) -> list[Specs] | None:
    """Returns the rooms of each block, in which they form a row; `None` if the rooms do not fit.

    Each room gets a block in which its area changes little.
    """
    depths = [min(area.width, area.depth) for area in areas]
    spare = [max(area.width, area.depth) for area in areas]
    dealt: list[list[RoomSpec]] = [[] for _ in areas]
    for spec in sorted(specs, key=lambda spec: -spec.area_m2):
        best, least = -1, math.inf
        for block, depth in enumerate(depths):
            width = _width(spec, depth)
            if _suits(spec, depth) and width / 2 < spare[block]:
                change = abs(math.log(width * depth / spec.area_m2)) + float(rng.uniform(0.0, 0.6))
                best, least = (block, change) if change < least else (best, least)
        if best < 0:
            return None
        dealt[best].append(spec)
        spare[best] -= _width(spec, depths[best])
    rows = [tuple(row_specs[k] for k in rng.permutation(len(row_specs))) for row_specs in dealt]
    fit = all(row_widths(area, row) is not None for area, row in zip(areas, rows, strict=True))
    return rows if fit else None
