"""Checks layouts of built-in scenes before compilation: one connected floor that reaches each category.

Pieces are approximated by boxes; `make scenes-check` compiles the seeds.
"""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.spatial import cKDTree

from factory.scenes.author.placement import FloorPlan
from factory.scenes.author.scene import BUILTIN_SCENES, PAPER_LAYOUTS, lay_out_scene
from factory.scenes.navigation.occupancy import BAND_M
from factory.scenes.rules import builtin_rules
from schemas.terms import BUILTIN_CATEGORIES, PAPER_SCENES
from tests.builders.layouts import FAMILIES, SEEDS, Layouts, piece_boxes
from workers.geometry.grid import CONNECT_CLEARANCE_M, FREE, OCCUPIED, Grid

CELL_M = 0.05
REACH_M = 0.97 + 0.2335 + CELL_M  # success radius, distance of the body's centre behind base_link, and one cell
RULES = builtin_rules()


def floor_of(plan: FloorPlan) -> Grid:
    """Returns the occupancy grid of the pieces in the height band of the robot."""
    boxes = piece_boxes(plan)
    solid = boxes[(boxes[:, 1, 2] > BAND_M[0]) & (boxes[:, 0, 2] < BAND_M[1])]
    origin = solid[:, 0, :2].min(axis=0)
    columns, rows = np.ceil((solid[:, 1, :2].max(axis=0) - origin) / CELL_M).astype(int)
    occupancy = np.full((rows, columns), FREE, np.uint8)
    for low, high in solid[:, :, :2]:
        (x0, y0), (x1, y1) = (
            np.floor((low - origin) / CELL_M).astype(int),
            np.ceil((high - origin) / CELL_M).astype(int),
        )
        occupancy[y0:y1, x0:x1] = OCCUPIED
    return Grid(occupancy, (float(origin[0]), float(origin[1])), CELL_M)


def connected_share(plan: FloorPlan, grid: Grid) -> float:
    """Returns the share of the floor with at least `CONNECT_CLEARANCE_M` of clearance that is connected.

    Only floor in rooms counts; in a plan without rooms, all floor counts.
    """
    wide, connected = grid.clearance >= CONNECT_CLEARANCE_M, grid.connected_floor()
    inside = np.full(wide.shape, not plan.rooms)
    for room in plan.rooms:
        rows, columns = (
            slice(*((np.array((low, high)) - start) // CELL_M).astype(int))
            for low, high, start in zip(room.area[1::-1], room.area[3:1:-1], grid.origin_m[::-1], strict=True)
        )
        inside[rows, columns] = True
    return float((connected & inside).sum() / (wide & inside).sum())


def reached_categories(plan: FloorPlan, grid: Grid) -> dict[str, int]:
    """Returns the number of objects of each category within reach of the connected floor."""
    floor = cKDTree(grid.centre_of(np.argwhere(grid.connected_floor())))
    reached: dict[str, int] = {}
    for placement in plan.placements:
        rule = RULES.match(re.sub(r"_\d+$", "", placement.name))
        if rule is not None and floor.query((placement.x, placement.y))[0] <= REACH_M:
            reached[rule.category] = reached.get(rule.category, 0) + 1
    return reached


@pytest.mark.parametrize("name", PAPER_SCENES)
def test_a_layout_of_the_paper_has_one_connected_floor_that_reaches_each_category(name: str) -> None:
    require_reach(lay_out_scene(PAPER_LAYOUTS[name], 0), name)


@pytest.mark.parametrize("name", PAPER_SCENES)
def test_every_seed_has_one_connected_floor_that_reaches_each_category(
    name: str, pytestconfig: pytest.Config, layouts: Layouts
) -> None:
    for seed in range(max(len(SEEDS), pytestconfig.getoption("--scene-seeds"))):
        plan = layouts[name, seed]
        assert plan is not None, f"seed {seed} has no layout"
        require_reach(plan, name)


def require_reach(plan: FloorPlan, name: str) -> None:
    """Checks that `connected_share` is at least 0.9 and that at least three objects of each category are in reach."""
    grid = floor_of(plan)
    assert connected_share(plan, grid) >= 0.9
    reached = reached_categories(plan, grid)
    wanted = {*BUILTIN_CATEGORIES[name].seen, *BUILTIN_CATEGORIES[name].held_out}
    assert {category: count for category in wanted if (count := reached.get(category, 0)) < 3} == {}


@pytest.mark.parametrize("name", FAMILIES)
def test_most_seeds_of_a_family_have_one_connected_floor_that_reaches_each_category(
    name: str, layouts: Layouts
) -> None:
    faults: dict[int, object] = {}
    wanted = {category for group in BUILTIN_CATEGORIES[name] for category in group}
    for seed in SEEDS:
        plan = layouts[name, seed]
        if plan is None:
            faults[seed] = "no division"
            continue
        grid = floor_of(plan)
        missing = wanted - reached_categories(plan, grid).keys()
        if missing or connected_share(plan, grid) < 0.85:
            faults[seed] = missing
    assert len(faults) <= len(SEEDS) // 3, faults


@pytest.mark.parametrize("name", FAMILIES)
def test_layouts_of_a_family_differ_in_rooms_doors_and_finishes(name: str, layouts: Layouts) -> None:
    plans = list(layouts.of(name).values())
    graphs = {tuple((room.kind, tuple(sorted(room.neighbours))) for room in plan.rooms) for plan in plans}
    assert len(graphs) >= len(plans) - 1
    finishes = {frozenset(piece.material.name for part in plan.structures for piece in part.pieces) for plan in plans}
    assert len(finishes) == len(plans) >= 4


@pytest.mark.parametrize("seed", [12, 16, 20, 23, 32])
def test_a_home_whose_first_layout_lacks_space_has_every_category_after_a_retry(seed: int) -> None:
    """These homes get a bed, a wardrobe, a washing machine or a division into rooms only after a retry."""
    plan = lay_out_scene(BUILTIN_SCENES["home"], seed)
    rules = [RULES.match(re.sub(r"_\d+$", "", placement.name)) for placement in plan.placements]
    wanted = {category for group in BUILTIN_CATEGORIES["home"] for category in group}
    assert wanted <= {rule.category for rule in rules if rule is not None}
