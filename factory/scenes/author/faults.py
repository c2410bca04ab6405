"""Finds faults of a floor plan before it is compiled: a missing category, or a room that the robot cannot reach because
furniture blocks the passage. Does not move furniture."""

from __future__ import annotations

import numpy as np

from factory.scenes.author.placement import FloorPlan, Rectangle
from factory.scenes.rules import builtin_rules
from schemas.terms import BUILTIN_CATEGORIES
from workers.geometry.grid import CONNECT_CLEARANCE_M, Grid

_CELL_M = 0.05
_BORDER_M = 0.5
_LEAST_SHARE = 0.5
"""The robot must reach more than this share of the free floor of a room."""


def find_fault(plan: FloorPlan, name: str) -> str | None:
    """Returns a fault of a floor plan of a built-in scene, or `None` if it can be compiled."""
    rules = [builtin_rules().match(model) for model in {placement.model.name for placement in plan.placements}]
    found = {rule.category for rule in rules if rule is not None}
    missing = sorted({category for group in BUILTIN_CATEGORIES[name] for category in group} - found)
    if missing:
        return f"no place for {', '.join(missing)}"
    cut_off = cut_off_rooms(plan)
    return f"furniture blocks the way to a {cut_off[0]}" if cut_off else None


def cut_off_rooms(plan: FloorPlan) -> list[str]:
    """Returns the kinds of the rooms in which at most half of the free floor is part of the largest connected floor.

    Free floor has at least the clearance of connected floor in scene packages. Door zones count as floor, footprints of
    standing props as obstacles.
    """
    areas = [room.area for room in plan.rooms]
    if not areas:
        return []
    x0, y0 = (min(getattr(area, side) for area in areas) - _BORDER_M for side in ("x0", "y0"))
    x1, y1 = (max(getattr(area, side) for area in areas) + _BORDER_M for side in ("x1", "y1"))
    occupied = np.ones((round((y1 - y0) / _CELL_M) + 1, round((x1 - x0) / _CELL_M) + 1), np.uint8)

    def cells(area: Rectangle) -> tuple[slice, slice]:
        rows, columns = (
            slice(max(int((low - start) // _CELL_M), 0), max(int(-((start - high) // _CELL_M)), 0))
            for low, high, start in ((area.y0, area.y1, y0), (area.x0, area.x1, x0))
        )
        return rows, columns

    for area in (*areas, *plan.kept_clear):
        occupied[cells(area)] = 0
    for area in plan.taken:
        occupied[cells(area)] = 1
    grid = Grid(occupied, (x0, y0), _CELL_M)
    floor, wide = grid.connected_floor(), grid.clearance >= CONNECT_CLEARANCE_M
    return [
        room.kind for room in plan.rooms if floor[cells(room.area)].sum() <= _LEAST_SHARE * wide[cells(room.area)].sum()
    ]
