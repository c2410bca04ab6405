"""Divides a rectangle into rooms by straight cuts, and chooses doors so that every room can be entered.

Pure: works on rectangles in metres and a random generator. Does not build walls and does not furnish.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

from numpy.random import Generator

from factory.scenes.author.placement import Rectangle
from factory.scenes.author.room import Doorway
from schemas.errors import WorldError

_TRIES, _OUTLINES = 600, 4
"""Divisions tried for one outline, and number of outlines of the same floor area."""
_GIVE = (0.8, 1.25)
"""Range of the factor by which the floor of a room may differ from its spec."""
_SLENDER = 2.1
"""Largest ratio of the sides of a room."""
_END_M = 0.45
"""Least distance between an opening and the end of the common wall, metres."""


class RoomSpec(NamedTuple):
    """Room of a building program: kind, desired floor and least side, metres."""

    kind: str
    area_m2: float
    least_m: float
    is_hub: bool = False
    """Whether other rooms may be entered from it."""


class Opening(NamedTuple):
    """Door or passage in the common wall of two rooms."""

    rooms: tuple[int, int]
    is_along_x: bool
    at: float
    doorway: Doorway


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
    """Probability of a further passage between two hubs."""


def divide_floor(
    rng: Generator, floor: Rectangle, specs: Sequence[RoomSpec], doors: Doors, hall_m: float | None = None
) -> Division:
    """Divides a floor so that every room has its least side and can be entered.

    Args:
        rng: random generator.
        floor: outer rectangle, between the centre lines of the outer walls; if no division of it is found, others
            of the same area and centre are tried.
        specs: rooms of the building.
        doors: widths of the openings.
        hall_m: width of a straight hall across the floor, or `None` for none; the hall is the last room.

    Raises:
        WorldError: no division was found.
    """
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
        areas = _cut(rng, floor, order) if hall_m is None else _cut_with_hall(rng, floor, order, hall_m)
        if areas is None:
            continue
        if hall_m is not None:
            order = (*order, RoomSpec("hall", 0.0, hall_m, is_hub=True))
        openings = _open(rng, order, areas, doors)
        if openings is not None:
            return Division(order, tuple(areas), tuple(openings))
    size = f"{outline.width:.1f} x {outline.depth:.1f} m"
    raise WorldError(f"no division of {size} into {len(specs)} rooms was found; use another seed")


def _suits(area: Rectangle, spec: RoomSpec) -> bool:
    short, long = sorted((area.width, area.depth))
    return short >= spec.least_m and long <= _SLENDER * short


def _cut(rng: Generator, floor: Rectangle, specs: Sequence[RoomSpec], strips: float = 0.0) -> list[Rectangle] | None:
    """Cuts a rectangle in two until each spec has a room of about its floor that suits it; `None` if that fails.

    `strips` is the probability with which cuts across x are tried first, so that the rooms form a row.
    """
    if len(specs) == 1:
        return [floor] if _suits(floor, specs[0]) else None
    total = sum(spec.area_m2 for spec in specs)
    shares = [sum(spec.area_m2 for spec in specs[:k]) / total for k in range(1, len(specs))]
    nearest = sorted(range(len(shares)), key=lambda k: abs(shares[k] - 0.5))[:3]
    ways = [(k, is_along_x) for k in nearest for is_along_x in (True, False)]
    order = sorted(rng.permutation(len(ways)), key=lambda number: not (ways[number][1] or rng.random() > strips))
    for number in order:
        k, is_along_x = ways[number]
        if is_along_x:
            x = floor.x0 + shares[k] * floor.width
            parts = floor._replace(x1=x), floor._replace(x0=x)
        else:
            y = floor.y0 + shares[k] * floor.depth
            parts = floor._replace(y1=y), floor._replace(y0=y)
        first = _cut(rng, parts[0], specs[: k + 1], strips)
        second = None if first is None else _cut(rng, parts[1], specs[k + 1 :], strips)
        if first is not None and second is not None:
            return first + second
    return None


def _cut_with_hall(
    rng: Generator, floor: Rectangle, specs: Sequence[RoomSpec], hall_m: float
) -> list[Rectangle] | None:
    """Cuts both sides of a hall along x; the hall is the last rectangle."""
    k = len(specs) // 2 + int(rng.integers(len(specs) % 2 + 1))
    share = sum(spec.area_m2 for spec in specs[:k]) / sum(spec.area_m2 for spec in specs)
    y = floor.y0 + share * (floor.depth - hall_m)
    south = _cut(rng, floor._replace(y1=y), specs[:k], 0.85)
    north = None if south is None else _cut(rng, floor._replace(y0=y + hall_m), specs[k:], 0.85)
    if south is None or north is None:
        return None
    return [*south, *north, floor._replace(y0=y, y1=y + hall_m)]


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
    """Returns a spanning tree of openings through hubs, with loops between hubs; `None` if a room stays closed."""
    pairs = [(i, j) for i, j in combinations(range(len(specs)), 2) if specs[i].is_hub or specs[j].is_hub]
    order = [pairs[k] for k in rng.permutation(len(pairs))]
    order.sort(key=lambda pair: not (specs[pair[0]].is_hub and specs[pair[1]].is_hub))
    group = list(range(len(specs)))
    found: list[Opening] = []
    for i, j in order:
        is_loop = group[i] == group[j]
        if is_loop and not (specs[i].is_hub and specs[j].is_hub and rng.random() < doors.loops):
            continue
        opening = _opening(rng, (i, j), specs, areas, doors)
        if opening is not None:
            found.append(opening)
            group = [group[i] if g == group[j] else g for g in group]
    return found if len(set(group)) == 1 else None


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
