"""Distances along the floor: straight, around obstacles, and none without a connection."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from schemas.config import TaskConfig
from tests.builders.scene import Box, box_room
from tests.unit.workers.planning.test_plan_search import FENCE, WALL, crate_of
from workers.geometry.grid import Grid
from workers.planning import geodesic_field, geodesic_m


def geodesic(start: tuple[float, float], *extra: Box, radius_m: float = 1.0) -> float | None:
    scene = box_room(extra)
    return geodesic_m(Grid.from_scene(scene), start, crate_of(scene), TaskConfig(success_radius_m=radius_m))


@pytest.mark.parametrize("start", [(-1.5, 0.0), (2.5, -2.0), (0.4, -2.4), (3.4, -1.1)])
def test_the_distance_along_a_free_straight_line_is_its_length_to_the_success_circle(start):
    assert geodesic(start) == pytest.approx(math.dist(start, (2.5, 1.3)) - 1.0, abs=1e-6)


def test_a_start_inside_the_circle_has_distance_zero():
    assert geodesic((1.8, 1.0)) == 0.0


def test_the_distance_around_a_wall_is_the_shortest_path():
    """The path passes the wall's corners (0.8, -1) and (1, -1) 0.25 m away and ends at the circle around (2.5, 1.3)."""
    found = geodesic((-1.5, 1.0), WALL)
    corners = ((-1.5, 1.0), (0.65, -1.2), (1.15, -1.2), (2.5, 1.3))
    taut = sum(math.dist(a, b) for a, b in itertools.pairwise(corners)) - 1.0
    assert found == pytest.approx(taut, rel=0.05)
    assert found > math.dist((-1.5, 1.0), (2.5, 1.3)) - 1.0


def test_two_sides_of_a_fence_are_not_connected():
    assert geodesic((-1.5, 1.0), FENCE) is None


def test_a_wall_at_the_target_blocks_the_success_circle():
    """A part of the success circle is on the start's side of the wall; this part does not count."""
    screen = Box((1.9, -3.0, 0.0), (2.0, 3.0, 2.5))
    assert geodesic((1.4, 1.3), screen) is None


def test_the_field_is_never_shorter_than_the_straight_line():
    scene = box_room([WALL])
    grid = Grid.from_scene(scene)
    field = geodesic_field(grid, crate_of(scene), TaskConfig()).metres
    rows, columns = np.nonzero(np.isfinite(field))
    points = grid.centre_of(np.column_stack([rows, columns]))
    straight = np.linalg.norm(points - np.asarray(crate_of(scene).centroid_m[:2]), axis=1) - 1.0
    assert (field[rows, columns] >= straight - 0.05).all()
