"""Checks the furniture of layouts before compilation: nothing floats, intersects, blocks a door or hides a window.

Pieces are approximated by upright boxes in the frame of their prop.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np
import pytest

from factory.scenes.author.placement import (
    FloorPlan,
    PropPlacement,
    Structure,
    footprint,
    hidden_share,
    penetration,
    solids,
)
from schemas.support.numpy_types import Floats
from tests.builders.layouts import FAMILIES, Layouts, wall_boxes, world_points

MOST_INTO_M = 0.0101
"""Permitted overlap of the boxes of two props, metres."""
MOST_AT_WINDOW_M = 0.05
"""Permitted overlap with a window, metres: worktops and tiles cover its foot, and curtains its frame."""
MOST_ON_TOP_M = 0.0201
"""Permitted overlap of two things on furniture, metres."""
NEAR_M, WALL_M = 0.03, 0.1
DOORS = ("SM_EntryDoor", "SM_RollerGate")
TALL_M, LARGE_M = 1.25, 0.8


def is_on_wall(placement: PropPlacement) -> bool:
    """Returns whether a prop hangs on a wall: its lowest point is above the floor, and it is not on furniture."""
    return bool(placement.model.low[2] > 0.1) and placement.z < 0.3


def intersections(plan: FloorPlan) -> Iterator[str]:
    """Yields the pairs of props that intersect; props on furniture are compared with each other only."""
    for one, two in combinations(plan.placements, 2):
        if (one.z > 0.3) == (two.z > 0.3) and one.floor_box.overlaps(two.floor_box):
            depth = max(penetration(a, b) for a in solids(one) for b in solids(two))
            is_window = any(each.model.name.startswith("SM_Window") for each in (one, two))
            most = MOST_AT_WINDOW_M if is_window else MOST_INTO_M if one.z <= 0.3 else MOST_ON_TOP_M
            if depth > most:
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


@pytest.mark.parametrize("name", FAMILIES)
def test_standing_props_touch_the_floor(name: str, layouts: Layouts) -> None:
    for seed, plan in layouts.of(name).items():
        for piece in plan.placements:
            is_standing = piece.z < 0.3 and piece.model.low[2] < 0.1 and "Curtain" not in piece.model.name
            assert not is_standing or abs(piece.heights[0]) <= 0.01, (seed, piece.name, piece.heights)


@pytest.mark.parametrize("name", FAMILIES)
def test_rugs_and_markings_do_not_share_floor(name: str, layouts: Layouts) -> None:
    """Surfaces in one plane flicker between their numbers of instances."""
    for seed, plan in layouts.of(name).items():
        flat = [part for part in plan.structures if part.name.startswith(("SM_Rug", "SM_Marking"))]
        boxes = [(part.name, points.min(axis=0), points.max(axis=0)) for part in flat for points in _points(part)]
        for (one, low, high), (two, other_low, other_high) in combinations(boxes, 2):
            overlap = np.minimum(high, other_high) - np.maximum(low, other_low)
            is_level = abs(high[2] - other_high[2]) < 0.0005
            assert not (is_level and (overlap[:2] > 1e-4).all()), (seed, one, two)


def _points(part: Structure) -> list[Floats]:
    return [piece.mesh.points for piece in part.pieces]


@pytest.mark.parametrize("name", FAMILIES)
def test_no_cabinet_or_board_hides_a_window_board_or_screen(name: str, layouts: Layouts) -> None:
    """Chairs, hung coats and screens on desks may hide a part of them."""
    for seed, plan in layouts.of(name).items():
        seen = [p for p in plan.placements if p.model.name.startswith(("SM_Window", "SM_Whiteboard", "SM_Television"))]
        large = [p for p in plan.placements if p.z < 0.3 and "Chair" not in p.model.name and p not in seen]
        for one in seen:
            for other in large:
                assert hidden_share(one, other) <= 0.25, (seed, one.name, other.name, hidden_share(one, other))


def test_the_desks_of_pupils_stand_in_rows_that_face_the_board(layouts: Layouts) -> None:
    for seed, plan in layouts.of("school").items():
        desks = [p for p in plan.placements if p.model.name.startswith("SM_TablePupil")]
        assert desks, seed
        for room in (room.area for room in plan.rooms if room.kind == "class"):
            inside = [p for p in desks if room.x0 < p.x < room.x1 and room.y0 < p.y < room.y1]
            assert len({round(p.yaw, 3) for p in inside}) <= 1, seed
            boards = [p for p in plan.placements if p.model.name.startswith("SM_Whiteboard")]
            near = [p for p in boards if room.grown(0.1).x0 < p.x < room.grown(0.1).x1 and room.y0 < p.y < room.y1]
            if near and inside:
                assert any(np.cos(p.yaw - inside[0].yaw) > 0.99 for p in near), seed
            across = sum(len(group) > 1 for group in _rows(inside))
            assert across >= min(2, len(inside) // 4), (seed, len(inside))


def _rows(desks: list[PropPlacement]) -> list[list[PropPlacement]]:
    """Returns the desks grouped by their distance from the board."""
    rows: dict[float, list[PropPlacement]] = {}
    for desk in desks:
        rows.setdefault(round(float(-np.sin(desk.yaw) * desk.x + np.cos(desk.yaw) * desk.y), 2), []).append(desk)
    return list(rows.values())
