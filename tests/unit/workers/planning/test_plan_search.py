"""Paths on the grid of a room: forward only, collision-free, and deterministic; `None` if no path exists."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from schemas.config import PlannerConfig, TaskConfig
from schemas.measure import Goal
from schemas.scene import CompiledScene, Target
from schemas.terms import SuccessMeasure
from tests.builders.scene import Box, box_room
from workers.geometry.grid import Grid
from workers.planning import Waypoint, geodesic_m, plan_path
from workers.planning.lattice import HEADINGS, MOVES, STEP_M, heading_of, pose_table, yaw_at

WALL = Box((0.8, -1.0, 0.0), (1.0, 3.0, 2.5))
"""Hides the crate from the west; the only path leads around its southern end."""
FENCE = Box((0.8, -3.0, 0.0), (1.0, 3.0, 2.5))
"""Fence from wall to wall, without a gap."""
START = Waypoint(-1.5, 0.0, 0.0)
CONFIG = PlannerConfig()


def crate_of(scene: CompiledScene) -> Target:
    return next(target for target in scene.info.targets if target.category == "crate")


def plan(*extra: Box, start: Waypoint = START, config: PlannerConfig = CONFIG) -> tuple[Waypoint, ...] | None:
    scene = box_room(extra)
    return plan_path(Grid.from_scene(scene), start, crate_of(scene), TaskConfig(), config)


def length_of(path: tuple[Waypoint, ...]) -> float:
    return sum(math.dist(a[:2], b[:2]) for a, b in itertools.pairwise(path))


def test_path_leads_around_a_wall_into_the_success_circle_with_sight():
    scene, path = box_room([WALL]), plan(WALL)
    assert path is not None
    assert path[0] == START
    assert math.dist(path[-1][:2], crate_of(scene).centroid_m[:2]) < 0.97
    assert Grid.from_scene(scene).has_sight(path[-1][:2], crate_of(scene))
    assert min(pose.y for pose in path) < -1.0
    assert 3.5 < length_of(path) < 7.0


@pytest.mark.parametrize("yaw", [-3.0, -1.6, 0.0, 0.7, 2.5])
def test_no_pose_of_a_path_leaves_the_free_space(yaw):
    grid = Grid.from_scene(box_room([WALL]))
    path = plan(WALL, start=START._replace(yaw=yaw))
    assert path is not None
    between = np.array(
        [(a.x + s * (b.x - a.x), a.y + s * (b.y - a.y), b.yaw) for a, b in itertools.pairwise(path) for s in (0.5, 1.0)]
    )
    assert grid.are_poses_free(*between.T).all()


@pytest.mark.parametrize("yaw", [-3.0, 0.0, 2.5])
def test_every_step_is_a_forward_arc_or_a_turn_on_the_spot(yaw):
    path = plan(WALL, start=START._replace(yaw=yaw))
    assert path is not None
    for before, after in itertools.pairwise(path):
        dx, dy = after.x - before.x, after.y - before.y
        turned = math.remainder(after.yaw - before.yaw, 2 * math.pi)
        chord = math.hypot(dx, dy)
        if chord < 1e-9:
            assert abs(turned) <= 2 * math.pi / HEADINGS + 1e-9
            continue
        assert math.remainder(math.atan2(dy, dx) - before.yaw - turned / 2, 2 * math.pi) == pytest.approx(0, abs=1e-6)
        assert abs(turned) <= 4 * math.pi / HEADINGS + 1e-9
        assert 0.98 * STEP_M < chord <= STEP_M + 1e-9


def test_planning_is_deterministic():
    assert plan(WALL) == plan(WALL)


def test_there_is_no_path_through_a_wall():
    assert plan(FENCE) is None


def test_a_search_gives_up_at_its_limit():
    assert plan(WALL, config=PlannerConfig(max_expansions=5)) is None


def test_a_start_in_an_obstacle_has_no_path():
    assert plan(WALL, start=Waypoint(0.9, 0.5, 0.0)) is None


def test_a_start_in_the_circle_with_sight_has_an_empty_path():
    path = plan(start=Waypoint(1.7, 1.3, 0.0), config=PlannerConfig(tight_margin_m=0.0))
    assert path is not None
    assert length_of(path) == 0.0


def test_the_conversions_between_headings_and_yaws_are_inverse():
    assert [heading_of(yaw_at(heading)) for heading in range(HEADINGS)] == list(range(HEADINGS))


def test_no_move_goes_backwards():
    for heading, moves in enumerate(MOVES):
        yaw = yaw_at(heading)
        assert all(move.end_x * math.cos(yaw) + move.end_y * math.sin(yaw) >= 0 for move in moves)


def test_the_pose_table_agrees_with_the_exact_test_up_to_a_cell():
    grid = Grid.from_scene(box_room([WALL]))
    table, rng = pose_table(grid, 0.0), np.random.default_rng(1)
    poses = np.column_stack([rng.uniform(-4, 4, 500), rng.uniform(-3, 3, 500), rng.uniform(-math.pi, math.pi, 500)])
    held = np.array([table.holds(grid, *pose) for pose in poses.tolist()])
    assert not (held & ~grid.are_poses_free(*poses.T, margin_m=-0.12)).any()
    assert not (~held & grid.are_poses_free(*poses.T, margin_m=0.12)).any()


def test_a_path_to_a_footprint_ends_within_a_metre_of_the_nearest_side():
    scene = box_room([Box((-1.0, -2.6, 0.0), (3.0, -0.6, 0.7), category="table")])
    table = next(target for target in scene.info.targets if target.category == "table")
    grid, start = Grid.from_scene(scene), Waypoint(-3.0, 1.5, 0.0)
    task = TaskConfig(success=SuccessMeasure.SURFACE)
    assert plan_path(grid, start, table, TaskConfig(), CONFIG) is None
    path = plan_path(grid, start, table, task, CONFIG)
    assert path is not None
    assert 0.5 < Goal.of(table, task).distance(*path[-1][:2]) <= 0.9
    straight = Goal.of(table, task).distance(*start[:2]) - 1.0
    assert geodesic_m(grid, start[:2], table, task) == pytest.approx(straight, abs=0.05)


@pytest.mark.parametrize("yaw", [-3.0, -1.6, 0.0, 1.6])
def test_a_path_that_faces_the_target_ends_with_the_target_ahead_and_turns_only_outside_of_the_circle(yaw):
    scene = box_room([WALL])
    crate, start = crate_of(scene), START._replace(yaw=yaw)
    path = plan_path(Grid.from_scene(scene), start, crate, TaskConfig(), CONFIG, facing=True)
    assert path is not None
    centre = crate.centroid_m[:2]
    bearing = math.atan2(centre[1] - path[-1].y, centre[0] - path[-1].x)
    assert abs(math.remainder(bearing - path[-1].yaw, 2 * math.pi)) < 0.5
    turns = [a for a, b in itertools.pairwise(path) if math.dist(a[:2], b[:2]) < 1e-9]
    assert all(math.dist(pose[:2], centre) > 1.1 for pose in turns)
