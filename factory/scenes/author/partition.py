"""Divides a floor into rooms by straight cuts, and chooses doors so that every room can be entered.

Pure: works on rectangles in metres and a random generator. Does not build walls and does not furnish.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, combinations
from typing import NamedTuple

from numpy.random import Generator

from factory.scenes.author.circulation import (
    HALL,
    SLENDER,
    Arrangement,
    Block,
    RoomSpec,
    Scheme,
    no_hall,
    row_widths,
)
from factory.scenes.author.placement import Rectangle
from factory.scenes.author.room import Doorway
from schemas.errors import WorldError

_TRIES, _OUTLINES = 600, 4
"""Number of divisions that are tried for each outline, and number of outlines; all have the same floor area."""
_GIVE = (0.8, 1.25)
"""For each division that is tried, the desired area of each room is multiplied by a random factor in this range."""
_END_M = 0.45
"""Least distance between an opening and an end of the wall that two rooms share, metres."""


class Opening(NamedTuple):
    """Door or passage in the common wall of two rooms, or the joint of two parts of a hall, which has no wall."""

    rooms: tuple[int, int]
    is_along_x: bool
    at: float
    doorway: Doorway

    @property
    def is_joint(self) -> bool:
        """Whether two parts of a hall meet here without a wall."""
        return math.isinf(self.doorway.height)


@dataclass(frozen=True)
class Division:
    """Rooms of a floor, and the openings between them."""

    specs: tuple[RoomSpec, ...]
    areas: tuple[Rectangle, ...]
    openings: tuple[Opening, ...]


class Doors(NamedTuple):
    """Clear widths of doors and passages, metres."""

    usual_m: float = 1.05
    open_m: Mapping[frozenset[str], tuple[float, float]] = {}
    """Range of the width of a passage without a door leaf, by the kinds of the two rooms."""
    loops: float = 0.5
    """Probability of an additional opening between two hubs."""


def divide_floor(
    rng: Generator, floor: Rectangle, specs: Sequence[RoomSpec], doors: Doors, scheme: Scheme = no_hall
) -> Division:
    """Divides a floor so that every side of a room has at least the length `least_m`, and every room can be entered.

    Args:
        rng: random generator.
        floor: outer rectangle, between the centre lines of the outer walls. If no division of it is found, other
            rectangles with the same area and centre are tried.
        specs: rooms of the building, without halls.
        doors: widths of the openings.
        scheme: arrangement of the halls; in the result, the parts of halls follow all other rooms.

    Raises:
        WorldError: no division was found.
    """
    # not from templates with random dimensions, which would repeat one graph of rooms
    outline, centre = floor, floor.centre
    for number in range(_OUTLINES * _TRIES):
        if number and number % _TRIES == 0:
            width = math.sqrt(outline.width * outline.depth * float(rng.uniform(1.0, 1.7)))
            depth = outline.width * outline.depth / width
            floor = Rectangle(
                centre[0] - width / 2, centre[1] - depth / 2, centre[0] + width / 2, centre[1] + depth / 2
            )
        order = tuple(
            specs[k]._replace(area_m2=specs[k].area_m2 * float(rng.uniform(*_GIVE)))
            for k in rng.permutation(len(specs))
        )
        division = _divide(rng, scheme(rng, floor, order), doors)
        if division is not None:
            return division
    size = f"{outline.width:.1f} x {outline.depth:.1f} m"
    raise WorldError(f"no division of {size} into {len(specs)} rooms was found")


def _divide(rng: Generator, arrangement: Arrangement | None, doors: Doors) -> Division | None:
    """Returns the rooms and openings of an arrangement; `None` if the rooms do not fit or a room cannot be entered."""
    areas: list[Rectangle] = []
    for block in () if arrangement is None else arrangement.blocks:
        cut = _row(block) if block.rows >= 1.0 else _cut(rng, block.area, block.specs, block.rows)
        if cut is None:
            return None
        areas += cut
    if arrangement is None:
        return None
    halls = [RoomSpec(HALL, 0.0, min(area.width, area.depth), is_hub=True) for area in arrangement.halls]
    specs = (*(spec for block in arrangement.blocks for spec in block.specs), *halls)
    areas += arrangement.halls
    openings = _open(rng, specs, areas, doors)
    return None if openings is None else Division(specs, tuple(areas), tuple(openings))


def _suits(area: Rectangle, spec: RoomSpec) -> bool:
    short, long = sorted((area.width, area.depth))
    return short >= spec.least_m and long <= SLENDER * short


def _row(block: Block) -> list[Rectangle] | None:
    """Cuts a block into rooms side by side along its longer side; `None` if they do not fit."""
    area, widths = block.area, row_widths(block.area, block.specs)
    if widths is None:
        return None
    ends = list(accumulate(widths))
    if area.width >= area.depth:
        return [area._replace(x0=area.x0 + e - w, x1=area.x0 + e) for e, w in zip(ends, widths, strict=True)]
    return [area._replace(y0=area.y0 + e - w, y1=area.y0 + e) for e, w in zip(ends, widths, strict=True)]


def _cut(rng: Generator, floor: Rectangle, specs: Sequence[RoomSpec], rows: float) -> list[Rectangle] | None:
    """Cuts a rectangle recursively until each spec has a suitable room of about its floor area; `None` if that fails.

    `rows` is the probability that cuts perpendicular to x, which put rooms side by side along x, are tried first.
    """
    if len(specs) == 1:
        return [floor] if _suits(floor, specs[0]) else None
    total = sum(spec.area_m2 for spec in specs)
    shares = [sum(spec.area_m2 for spec in specs[:k]) / total for k in range(1, len(specs))]
    nearest = sorted(range(len(shares)), key=lambda k: abs(shares[k] - 0.5))[:3]
    ways = [(k, is_along_x) for k in nearest for is_along_x in (True, False)]
    order = sorted(rng.permutation(len(ways)), key=lambda number: not (ways[number][1] or rng.random() > rows))
    for number in order:
        k, is_along_x = ways[number]
        if is_along_x:
            x = floor.x0 + shares[k] * floor.width
            parts = floor._replace(x1=x), floor._replace(x0=x)
        else:
            y = floor.y0 + shares[k] * floor.depth
            parts = floor._replace(y1=y), floor._replace(y0=y)
        first = _cut(rng, parts[0], specs[: k + 1], rows)
        second = None if first is None else _cut(rng, parts[1], specs[k + 1 :], rows)
        if first is not None and second is not None:
            return first + second
    return None


def _common_wall(one: Rectangle, two: Rectangle) -> tuple[bool, float, float, float] | None:
    """Returns (is along x, position, start, end) of the wall between two rooms, or `None`."""
    for is_along_x, a, b in ((True, (one.y0, one.y1), (two.y0, two.y1)), (False, (one.x0, one.x1), (two.x0, two.x1))):
        at = next((p for p, q in ((a[1], b[0]), (a[0], b[1])) if abs(p - q) < 1e-6), None)
        if at is None:
            continue
        first, second = ((one.x0, one.x1), (two.x0, two.x1)) if is_along_x else ((one.y0, one.y1), (two.y0, two.y1))
        low, high = max(first[0], second[0]), min(first[1], second[1])
        if high - low > 0.5:
            return is_along_x, at, low, high
    return None


def _open(rng: Generator, specs: Sequence[RoomSpec], areas: Sequence[Rectangle], doors: Doors) -> list[Opening] | None:
    """Returns the openings of all rooms; `None` if a room cannot be entered.

    These are the joints of the hall, a spanning tree of openings, and random additional openings between hubs. Each
    opening has a hub on at least one side.
    """
    pairs = [(i, j) for i, j in combinations(range(len(specs)), 2) if specs[i].is_hub or specs[j].is_hub]
    order = [pairs[k] for k in rng.permutation(len(pairs))]
    order.sort(key=lambda pair: not (specs[pair[0]].is_hub and specs[pair[1]].is_hub))
    group = list(range(len(specs)))
    openings = list(_joints(specs, areas))
    for joint in openings:
        i, j = joint.rooms
        group = [group[i] if g == group[j] else g for g in group]
    for i, j in order:
        if specs[i].kind == specs[j].kind == HALL:
            continue
        is_loop = group[i] == group[j]
        if is_loop and not (specs[i].is_hub and specs[j].is_hub and rng.random() < doors.loops):
            continue
        opening = _opening(rng, (i, j), specs=specs, areas=areas, doors=doors)
        if opening is not None:
            openings.append(opening)
            group = [group[i] if g == group[j] else g for g in group]
    return openings if len(set(group)) == 1 else None


def _joints(specs: Sequence[RoomSpec], areas: Sequence[Rectangle]) -> Iterator[Opening]:
    """Yields the joints of adjoining parts of the hall."""
    halls = [number for number, spec in enumerate(specs) if spec.kind == HALL]
    for i, j in combinations(halls, 2):
        shared = _common_wall(areas[i], areas[j])
        if shared is not None:
            is_along_x, at, low, high = shared
            yield Opening((i, j), is_along_x, at, Doorway((low + high) / 2, high - low, math.inf))


def turned(rng: Generator, division: Division) -> Division:
    """Returns a division in one of its eight rotations and reflections, drawn at random."""
    is_swapped, flip_x, flip_y = (bool(rng.random() < 0.5) for _ in range(3))

    def point(x: float, y: float) -> tuple[float, float]:
        x, y = (-x if flip_x else x), (-y if flip_y else y)
        return (y, x) if is_swapped else (x, y)

    def rectangle(area: Rectangle) -> Rectangle:
        (xa, ya), (xb, yb) = point(area.x0, area.y0), point(area.x1, area.y1)
        return Rectangle(min(xa, xb), min(ya, yb), max(xa, xb), max(ya, yb))

    def opening(each: Opening) -> Opening:
        centre, at = each.doorway.centre, each.at
        x, y = point(*((centre, at) if each.is_along_x else (at, centre)))
        is_along_x = each.is_along_x != is_swapped
        along, across = (x, y) if is_along_x else (y, x)
        return each._replace(is_along_x=is_along_x, at=across, doorway=each.doorway._replace(centre=along))

    return Division(
        division.specs,
        tuple(rectangle(area) for area in division.areas),
        tuple(opening(each) for each in division.openings),
    )


def _opening(
    rng: Generator, pair: tuple[int, int], specs: Sequence[RoomSpec], areas: Sequence[Rectangle], doors: Doors
) -> Opening | None:
    """Returns an opening in the common wall, as wide as the kinds of the rooms permit, or `None`."""
    shared = _common_wall(areas[pair[0]], areas[pair[1]])
    if shared is None:
        return None
    is_along_x, at, low, high = shared
    wide = doors.open_m.get(frozenset((specs[pair[0]].kind, specs[pair[1]].kind)))
    width = doors.usual_m if wide is None else min(float(rng.uniform(*wide)), high - low - 2 * _END_M)
    reach = width / 2 + _END_M
    if width < doors.usual_m or high - low < 2 * reach:
        return None
    centre = float(rng.uniform(low + reach, high - reach))
    height = 2.1 if wide is None else 2.3
    return Opening(pair, is_along_x, at, Doorway(centre, width, height))
