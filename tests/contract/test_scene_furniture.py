"""Checks the furniture of layouts before compilation: nothing floats, intersects, blocks a door or covers a window.

Pieces are approximated by upright boxes in the frame of their prop.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np
import pytest

from factory.scenes.author.placement import FloorPlan, PropPlacement, footprint
from tests.builders.layouts import FAMILIES, Layouts, Solid, penetration, wall_boxes, world_points

MOST_INTO_M = 0.05
"""Permitted overlap of two props, metres. A worktop may cover the foot of a window; arm rests may be under a desk."""
NEAR_M, WALL_M = 0.03, 0.1
DOORS = ("SM_EntryDoor", "SM_RollerGate")
TALL_M, LARGE_M = 1.25, 0.8


def solids(placement: PropPlacement) -> list[Solid]:
    """Returns the boxes of the pieces of a prop."""
    meshes = [piece.mesh.points for piece in placement.model.pieces]
    return [Solid(points.min(axis=0), points.max(axis=0), placement) for points in meshes]


def is_on_wall(placement: PropPlacement) -> bool:
    """Returns whether a prop hangs on a wall: its lowest point is above the floor, and it is not on furniture."""
    return bool(placement.model.low[2] > 0.1) and placement.z < 0.3


def intersections(plan: FloorPlan) -> Iterator[str]:
    """Yields the pairs of props that intersect; props on furniture are compared with each other only."""
    for one, two in combinations(plan.placements, 2):
        if (one.z > 0.3) == (two.z > 0.3) and one.floor_box.overlaps(two.floor_box):
            depth = max(penetration(a, b) for a in solids(one) for b in solids(two))
            if depth > MOST_INTO_M:
                yield f"{one.name} and {two.name} by {depth:.3f} m at {one.x:.2f}, {one.y:.2f}"


@pytest.mark.parametrize("name", FAMILIES)
def test_no_two_props_intersect(name: str, layouts: Layouts) -> None:
    found = {seed: list(intersections(plan)) for seed, plan in layouts.of(name).items()}
    assert {seed: pairs for seed, pairs in found.items() if pairs} == {}


@pytest.mark.parametrize("name", FAMILIES)
def test_objects_on_furniture_have_a_surface_below_them(name: str, layouts: Layouts) -> None:
    floating = []
    for seed, plan in layouts.of(name).items():
        standing = [placement for placement in plan.placements if placement.z <= 0.3]
        boxes = [np.array([(p.min(axis=0), p.max(axis=0)) for p in world_points(placement)]) for placement in standing]
        for thing in plan.placements:
            if thing.z > 0.3:
                at = np.array((thing.x, thing.y))
                below = [box[(box[:, 0, :2] < at).all(axis=1) & (box[:, 1, :2] > at).all(axis=1)] for box in boxes]
                tops = np.concatenate([box[:, 1, 2] for box in below])
                if not (np.abs(tops - thing.z) < NEAR_M).any():
                    floating.append((seed, thing.name))
    assert floating == []


@pytest.mark.parametrize("name", FAMILIES)
def test_wall_objects_are_attached_to_a_wall(name: str, layouts: Layouts) -> None:
    floating = []
    for seed, plan in layouts.of(name).items():
        walls = wall_boxes(plan)
        for thing in filter(is_on_wall, plan.placements):
            if thing.model.name.startswith("SM_Pennants"):
                continue  # pennants hang below the ceiling and not on a wall
            back = float(thing.model.high[1])
            middle = (thing.model.low[2] + thing.model.high[2]) / 2 + thing.z
            point = np.array((thing.x - np.sin(thing.yaw) * back, thing.y + np.cos(thing.yaw) * back, middle))
            away = np.maximum(np.maximum(walls[:, 0] - point, point - walls[:, 1]), 0.0)
            if np.linalg.norm(away, axis=1).min() > WALL_M:
                floating.append((seed, thing.name))
    assert floating == []


@pytest.mark.parametrize("name", FAMILIES)
def test_no_large_furniture_blocks_a_door_or_covers_a_window(name: str, layouts: Layouts) -> None:
    for plan in layouts.of(name).values():
        windows = [
            p.floor_box for p in plan.placements if p.model.name.startswith("SM_Window") and p.model.low[2] < 2.0
        ]
        for placement in plan.placements:
            if placement.z > 0.0 or placement.model.low[2] > 0.5 or placement.model.name.startswith(DOORS):
                continue
            print_ = footprint(placement.model, placement.x, placement.y, placement.yaw)
            assert not any(print_.grown(-0.01).overlaps(zone) for zone in plan.kept_clear), placement.name
            if placement.model.high[2] > TALL_M and max(print_.width, print_.depth) > LARGE_M:
                assert not any(print_.overlaps(window) for window in windows), placement.name
