"""The poses and moves a path is made of: 36 headings, forward arcs and turns on the spot, and which poses are free.

Tables over the occupancy grid; searches nothing. No move goes backwards (docs/design/experts.md#planner).
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.geometry.grid import DISC_OFFSETS_M, DISC_RADIUS_M, Grid

__all__ = [
    "HEADINGS",
    "MOVES",
    "STEP_M",
    "MotionPrimitive",
    "PoseTable",
    "Waypoint",
    "heading_of",
    "pose_table",
    "yaw_at",
]

HEADINGS = 36
STEP_M = 0.2
"""Length of an arc."""
_BENDS = (0, 1, -1, 2, -2)
"""Headings by which an arc turns: straight, radius 1.15 m, radius 0.57 m."""
_DECIMALS = 12
"""The tables are rounded, so that no last bit of a library's sine decides between two paths."""


class Waypoint(NamedTuple):
    """A planar pose of base_link in the world frame."""

    x: float
    """Metres."""
    y: float
    """Metres."""
    yaw: float
    """Radians in (-pi, pi]."""


class MotionPrimitive(NamedTuple):
    """A move from one heading: an arc of `STEP_M` or, with `length_m` 0, a turn on the spot by one heading."""

    mid_x: float
    """Displacement at half the arc, metres in the world frame."""
    mid_y: float
    end_x: float
    end_y: float
    heading: int
    """At the end."""
    length_m: float
    turn: int
    """Number of headings turned, unsigned."""


def heading_of(yaw: float) -> int:
    """Returns the number of the heading nearest to a yaw in radians."""
    return round(yaw * HEADINGS / (2 * math.pi)) % HEADINGS


def yaw_at(heading: int) -> float:
    """Returns the yaw of a heading in radians, in (-pi, pi]."""
    turned = heading % HEADINGS
    return (turned if turned <= HEADINGS // 2 else turned - HEADINGS) * 2 * math.pi / HEADINGS


def _arc(yaw: float, angle: float, length: float) -> tuple[float, float]:
    """Displacement along an arc that starts at `yaw` and turns by `angle`; both radians."""
    chord = length if angle == 0 else length * math.sin(angle / 2) / (angle / 2)
    along = yaw + angle / 2
    return round(chord * math.cos(along), _DECIMALS), round(chord * math.sin(along), _DECIMALS)


def _moves_from(heading: int) -> tuple[MotionPrimitive, ...]:
    yaw, step = yaw_at(heading), 2 * math.pi / HEADINGS
    arcs = (
        MotionPrimitive(
            *_arc(yaw, bend * step / 2, STEP_M / 2),
            *_arc(yaw, bend * step, STEP_M),
            (heading + bend) % HEADINGS,
            STEP_M,
            abs(bend),
        )
        for bend in _BENDS
    )
    turns = (MotionPrimitive(0.0, 0.0, 0.0, 0.0, (heading + turn) % HEADINGS, 0.0, 1) for turn in (1, -1))
    return (*arcs, *turns)


MOVES = tuple(_moves_from(heading) for heading in range(HEADINGS))
"""The moves from each heading, in the order in which equal ones are preferred."""


@dataclass(frozen=True, eq=False)
class PoseTable:
    """Which poses of base_link are free, by heading and cell; a pose counts as at its cell's centre."""

    grid: Grid
    free: NDArray[np.bool_]
    """(HEADINGS, H, W)."""

    @functools.cached_property
    def flags(self) -> bytes:
        """`free` as one byte a pose, in C order: the fastest thing to look up one by one."""
        return self.free.tobytes()

    @functools.cached_property
    def floor(self) -> NDArray[np.bool_]:
        """(H, W) cells on which at least one heading is free."""
        return np.asarray(self.free.any(axis=0))

    def holds(self, x: float, y: float, yaw: float) -> bool:
        """Whether the footprint is free at a pose, up to the table's resolution."""
        return bool(self.grid.values_at(self.free[heading_of(yaw)], (x, y), False))


@functools.lru_cache(maxsize=4)
def pose_table(grid: Grid, margin_m: float) -> PoseTable:
    """Returns the free poses of a grid with `margin_m` of free space around the three discs of the footprint."""
    wide = grid.clearance >= DISC_RADIUS_M + margin_m
    height, width = wide.shape
    rim = math.ceil(max(map(abs, DISC_OFFSETS_M)) / grid.resolution_m) + 1
    padded = np.pad(wide, rim)
    free = np.ones((HEADINGS, height, width), bool)
    for heading in range(HEADINGS):
        yaw = yaw_at(heading)
        for offset in DISC_OFFSETS_M:
            row = rim + round(round(offset * math.sin(yaw), _DECIMALS) / grid.resolution_m)
            column = rim + round(round(offset * math.cos(yaw), _DECIMALS) / grid.resolution_m)
            free[heading] &= padded[row : row + height, column : column + width]
    return PoseTable(grid, free)
