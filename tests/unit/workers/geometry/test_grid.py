"""The occupancy grid: footprints, straight lines, sight and connected floor."""

from __future__ import annotations

import math

import numpy as np
import pytest

from schemas.scene import Target
from workers.geometry.grid import Grid, body_centre


def grid_of(*occupied: tuple[float, float, float, float], value: int = 1, size_m: float = 6.0) -> Grid:
    """A square grid from (-3, -3) with boxes (x0, y0, x1, y1) of occupied cells."""
    cells = round(size_m / 0.05)
    occupancy = np.zeros((cells, cells), np.uint8)
    for x0, y0, x1, y1 in occupied:
        columns = slice(round((x0 + 3) / 0.05), round((x1 + 3) / 0.05))
        rows = slice(round((y0 + 3) / 0.05), round((y1 + 3) / 0.05))
        occupancy[rows, columns] = value
    return Grid(occupancy, (-3.0, -3.0), 0.05)


def target_at(x: float, y: float, side: float = 0.4) -> Target:
    return Target(
        target_id="chair_001",
        category="chair",
        instance_id=1,
        prim_path="/chair",
        centroid_m=(x, y, 0.4),
        size_m=(side, side, 0.8),
    )


def test_the_conversions_between_cell_and_centre_are_inverse() -> None:
    grid = grid_of()
    cells = np.array([[0, 0], [5, 17], [119, 3]])
    assert (grid.cell_of(grid.centre_of(cells)) == cells).all()


def test_row_is_y_and_column_is_x() -> None:
    assert grid_of().cell_of((-2.99, -2.8)).tolist() == [4, 0]


def test_space_outside_of_the_grid_counts_as_occupied() -> None:
    grid = grid_of()
    assert grid.clearance_at((10.0, 0.0)) == 0.0
    assert grid.clearance_at((-2.99, 0.0)) == pytest.approx(0.05)
    assert not grid.is_pose_free(-2.9, 0.0, 0.0)


def test_clearance_is_the_distance_to_the_nearest_occupied_cell() -> None:
    grid = grid_of((1.0, -3.0, 1.1, 3.0))
    assert grid.clearance_at((0.025, 0.025)) == pytest.approx(1.0)


@pytest.mark.parametrize(("x", "free"), [(0.55, True), (0.8, False)])
def test_footprint_needs_room_in_front_of_the_axle(x: float, free: bool) -> None:
    assert grid_of((1.0, -3.0, 1.1, 3.0)).is_pose_free(x, 0.0, 0.0) is free


def test_footprint_reaches_further_back_than_forward() -> None:
    wall = grid_of((1.0, -3.0, 1.1, 3.0))
    assert wall.is_pose_free(0.6, 0.0, 0.0)
    assert not wall.is_pose_free(0.6, 0.0, math.pi)


def test_margin_widens_the_footprint() -> None:
    lane = grid_of((-3, 0.35, 3, 0.5), (-3, -0.5, 3, -0.35))
    assert lane.is_pose_free(0.0, 0.0, 0.0)
    assert not lane.is_pose_free(0.0, 0.0, 0.0, margin_m=0.15)


def test_the_check_of_many_poses_agrees_with_single_checks() -> None:
    grid = grid_of((1.0, -1.0, 1.5, 1.0))
    rng = np.random.default_rng(1)
    x, y, yaw = rng.uniform(-2, 2, 50), rng.uniform(-2, 2, 50), rng.uniform(-3, 3, 50)
    many = grid.are_poses_free(x, y, yaw)
    assert many.tolist() == [grid.is_pose_free(*pose) for pose in zip(x, y, yaw, strict=True)]


def test_a_line_through_a_gap_needs_room_for_the_body_and_its_clearance() -> None:
    gap = grid_of((0.0, 0.45, 0.2, 3.0), (0.0, -3.0, 0.2, -0.45))
    assert gap.is_line_free((-2, 0), (2, 0), clearance_m=0.10)
    assert not gap.is_line_free((-2, 0), (2, 0), clearance_m=0.25)
    assert not gap.is_line_free((-2, 0.4), (2, 0.4), clearance_m=0.0)


def test_a_thin_post_between_the_tracks_blocks_a_line() -> None:
    for y in np.arange(-0.3, 0.31, 0.05):
        post = grid_of((0.0, float(y), 0.05, float(y) + 0.05))
        assert not post.is_line_free((-2, 0), (2, 0), clearance_m=0.10)


def test_a_line_may_end_close_before_a_wall() -> None:
    wall = grid_of((1.0, -3.0, 1.1, 3.0))
    assert wall.is_line_free((-2, 0), (0.8, 0), clearance_m=0.10)
    assert not wall.is_line_free((-2, 0), (0.95, 0), clearance_m=0.10)


def test_a_wall_hides_a_target_and_a_desk_does_not() -> None:
    target = target_at(1.0, 0.0)
    assert not grid_of((0.5, -3, 0.6, 3), value=2).has_sight((-1.0, 0.0), target)
    assert grid_of((0.5, -3, 0.6, 3), value=1).has_sight((-1.0, 0.0), target)


def test_a_target_does_not_hide_itself() -> None:
    assert grid_of((0.8, -0.2, 1.2, 0.2), value=2).has_sight((-1.0, 0.0), target_at(1.0, 0.0))


def test_floor_behind_a_wall_is_not_connected() -> None:
    split = grid_of((0.5, -3.0, 0.6, 3.0))
    floor = split.connected_floor()
    assert split.values_at(floor, (-1.0, 0.0), False)
    assert not split.values_at(floor, (2.0, 0.0), False)
    seeded = split.connected_floor(seed_xy=(2.0, 0.0))
    assert split.values_at(seeded, (2.0, 0.0), False)


def test_a_grid_without_floor_has_no_connected_floor() -> None:
    assert not grid_of((-3, -3, 3, 3)).connected_floor().any()


def test_body_centre_is_behind_the_axle() -> None:
    assert body_centre(1.0, 0.0, math.pi / 2) == pytest.approx([1.0, -0.2335])
