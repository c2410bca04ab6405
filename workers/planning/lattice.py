"""State lattice of the path planner: 36 headings, forward arcs, turns on the spot, and the table of free poses.

No move goes backwards (docs/design/experts.md#planner). Does not search paths.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.geometry.grid import DISC_OFFSETS_M, DISC_RADIUS_M, Grid
from workers.planning.kept import kept_with_grid

HEADINGS = 36
"""Number of headings."""
STEP_M = 0.2
"""Length of an arc, metres."""
_BENDS = (0, 1, -1, 2, -2)
"""Changes of heading along an arc, in differences of heading numbers: straight, radius 1.15 m, radius 0.57 m."""
_DECIMALS = 12
"""Decimals of the tables; rounding makes the choice between two paths independent of the last bit of a sine."""


class Waypoint(NamedTuple):
    """Planar pose of base_link in the world frame."""

    x: float
    """x, metres."""
    y: float
    """y, metres."""
    yaw: float
    """Heading, radians in (-pi, pi]."""


class MotionPrimitive(NamedTuple):
    """Move from one heading: an arc of `STEP_M` or, with `length_m` 0, a turn on the spot by one heading."""

    mid_x: float
    """x displacement at half the arc in the world frame, metres."""
    mid_y: float
    """y displacement at half the arc in the world frame, metres."""
    end_x: float
    """x displacement at the end in the world frame, metres."""
    end_y: float
    """y displacement at the end in the world frame, metres."""
    heading: int
    """Number of the heading at the end."""
    length_m: float
    """Length of the arc, metres; 0 for a turn on the spot."""
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
    """Returns the displacement along an arc that starts at `yaw` and turns by `angle`, both radians, metres."""
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
    turns = (
        MotionPrimitive(0.0, 0.0, end_x=0.0, end_y=0.0, heading=(heading + turn) % HEADINGS, length_m=0.0, turn=1)
        for turn in (1, -1)
    )
    return (*arcs, *turns)


MOVES = tuple(_moves_from(heading) for heading in range(HEADINGS))
"""Moves from each heading; the search prefers the first of moves with equal cost."""


@dataclass(frozen=True, eq=False)
class PoseTable:
    """Table of free poses of base_link by heading and cell; each pose is moved to the centre of its cell."""

    flags: bytes
    """(HEADINGS, H, W) 1 for free poses, in C order; the fastest format for single lookups."""
    shape: tuple[int, int]
    """Shape (H, W) of the grid."""

    @property
    def free(self) -> NDArray[np.bool_]:
        """(HEADINGS, H, W) true for free poses; a view of the flags."""
        return np.frombuffer(self.flags, bool).reshape(HEADINGS, *self.shape)

    @functools.cached_property
    def floor(self) -> NDArray[np.bool_]:
        """(H, W) cells on which at least one heading is free."""
        return np.asarray(self.free.any(axis=0))

    def holds(self, grid: Grid, x: float, y: float, yaw: float) -> bool:
        """Returns whether the footprint is free at a pose on the grid, within the table's resolution."""
        return bool(grid.values_at(self.free[heading_of(yaw)], (x, y), False))


@kept_with_grid(2)
def pose_table(grid: Grid, margin_m: float) -> PoseTable:
    """Returns the table of poses of a grid with `margin_m` of free space around the three discs of the footprint."""
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
    return PoseTable(free.tobytes(), wide.shape)
