"""Fills the floor of a hall with rows of racks and shelves along x or y, with aisles, cross aisles and floor markings.

Places props and markings in metres; every rack bay is a separate prop. Does not build the hall.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

from factory.scenes.author.furnisher import Furnisher
from factory.scenes.author.materials import painted, textured
from factory.scenes.author.placement import Rectangle
from factory.scenes.author.room import marking

BAY_M, SHELF_M = 2.72, 1.24
"""Pitch of the bays in a row of racks, and pitch of the units in a row of shelves, metres."""
RACK_DEPTH_M = 0.84
_YELLOW = painted("Yellow", 0.6)
_HAZARD = textured("Hazard", "#d8ac20", 0.5, 0.7)
_CROSS_M = 1.35
"""Half the width of a cross aisle, metres."""
_BACK_M = 0.06
"""Distance between the backs of a double row, metres."""


class RackPlan(NamedTuple):
    """Arrangement of the rows of one hall."""

    kinds: tuple[str, ...]
    """Kinds of the rows (rack or shelf), which alternate in this order."""
    is_along_x: bool
    aisle_m: float
    double: float
    """Probability that a row has a second row at its back."""
    cross: tuple[float, ...]
    """Positions of the cross aisles, as shares of the length of the rows."""
    ragged: float
    """Probability that a row is one bay shorter at an end."""
    filled: float
    """Probability that a place in a row contains a bay or a shelf unit."""
    frame: int
    """Variant of the racks and shelves: colour of the frames."""


class _Row(NamedTuple):
    """Row of storage units: kind, position across the rows, and direction of the front (-1 or 1 across the rows)."""

    kind: str
    at: float
    front: int


class _Frame(NamedTuple):
    """Converts positions along and across the rows to world coordinates."""

    area: Rectangle
    is_along_x: bool

    @property
    def size(self) -> tuple[float, float]:
        """Length and width, metres."""
        return (self.area.width, self.area.depth) if self.is_along_x else (self.area.depth, self.area.width)

    def point(self, along: float, across: float) -> tuple[float, float]:
        """Returns x and y, metres."""
        shift = (along, across) if self.is_along_x else (across, along)
        return self.area.x0 + shift[0], self.area.y0 + shift[1]

    def rectangle(self, along: tuple[float, float], across: tuple[float, float]) -> Rectangle:
        """Returns a rectangle with ranges along and across the rows."""
        return Rectangle(*self.point(along[0], across[0]), *self.point(along[1], across[1]))

    def yaw(self, front: int) -> float:
        """Returns the yaw of a unit, radians; `front` is the direction of its front across the rows, -1 or 1."""
        return (0.0 if front < 0 else math.pi) if self.is_along_x else front * math.pi / 2


def fill_with_racks(furnisher: Furnisher, area: Rectangle, racks: RackPlan) -> int:
    """Places the rows that fit into a part of the floor; returns their number."""
    frame = _Frame(area, racks.is_along_x)
    rows = list(_rows(furnisher, frame.size[1], racks))
    for row in rows:
        _fill_row(furnisher, frame, row, racks)
    return len(rows)


def _rows(furnisher: Furnisher, width: float, racks: RackPlan) -> Iterator[_Row]:
    """Yields the rows, spread evenly over the width; the two rows of a double row are back to back."""
    pitch = RACK_DEPTH_M + racks.aisle_m
    groups: list[tuple[str, bool]] = []
    used = 0.0
    while used + RACK_DEPTH_M < width:
        kind = racks.kinds[len(groups) % len(racks.kinds)]
        is_double = bool(furnisher.rng.random() < racks.double) and used + 2 * RACK_DEPTH_M + _BACK_M < width
        groups.append((kind, is_double))
        used += pitch + (RACK_DEPTH_M + _BACK_M if is_double else 0.0)
    spare = width - (used - racks.aisle_m)
    at = RACK_DEPTH_M / 2 + spare / 2
    for kind, is_double in groups:
        if is_double:
            yield _Row(kind, at, -1)
            at += RACK_DEPTH_M + _BACK_M
            yield _Row(kind, at, 1)
        else:
            yield _Row(kind, at, -1 if furnisher.rng.random() < 0.5 else 1)
        at += pitch


def _fill_row(furnisher: Furnisher, frame: _Frame, row: _Row, racks: RackPlan) -> None:
    """Places bays or shelf units between the cross aisles."""
    length, plan = frame.size[0], furnisher.plan
    pitch = BAY_M if row.kind == "rack" else SHELF_M
    marks = [0.0, *(share * length for share in racks.cross), length]
    for number, (low, high) in enumerate(pairwise(marks)):
        start = low + (_CROSS_M if number else 0.0)
        end = high - (_CROSS_M if number < len(marks) - 2 else 0.0)
        count = int((end - start) // pitch)
        shorter = [count > 2 and bool(furnisher.rng.random() < racks.ragged) for _ in range(2)]
        first = int(shorter[0]) if number == 0 else 0
        last = count - (int(shorter[1]) if number == len(marks) - 2 else 0)
        start += (end - start - count * pitch) / 2
        placed = []
        for slot in range(first, last):
            if furnisher.rng.random() < racks.filled:
                look = racks.frame % 3 + 3 * plan.pick(3) if row.kind == "rack" else racks.frame % 4 + 4 * plan.pick(2)
                name = "SM_RackPile_04" if row.kind == "rack" else "SM_ShelfSteel_A"
                x, y = frame.point(start + (slot + 0.5) * pitch, row.at)
                if (
                    plan.place(furnisher.model(name, look), x, y, frame.yaw(row.front), furnisher.area, -0.05)
                    is not None
                ):
                    placed.append(slot)
        if placed:
            _mark(furnisher, frame, row, (start + placed[0] * pitch, start + (placed[-1] + 1) * pitch))


def _mark(furnisher: Furnisher, frame: _Frame, row: _Row, ends: tuple[float, float]) -> None:
    """Adds a yellow line before a row, hazard patches at its ends, and impact posts at the ends of racks."""
    edge = row.at + row.front * 0.58
    marking(furnisher.plan, frame.rectangle((ends[0] - 0.25, ends[1] + 0.25), (edge - 0.04, edge + 0.04)), _YELLOW)
    for at in (ends[0] - 0.35, ends[1] + 0.25):
        marking(furnisher.plan, frame.rectangle((at, at + 0.1), (row.at - 0.4, row.at + 0.4)), _HAZARD)
    if row.kind == "rack":
        post = furnisher.model("SM_ImpactPost", 0)
        for at in (ends[0] - 0.12, ends[1] + 0.12):
            furnisher.plan.place(post, *frame.point(at, row.at + row.front * 0.33), 0.0, furnisher.area, -0.05)
