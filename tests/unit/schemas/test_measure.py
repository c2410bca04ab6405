"""The goal region: distances to a footprint, and points on straight lines at a distance."""

from __future__ import annotations

import math

import numpy as np
import pytest

from schemas.config import TaskConfig
from schemas.errors import WorldError
from schemas.measure import Goal, shows_nothing
from schemas.support.geometry import footprint_distances
from schemas.terms import SuccessMeasure
from tests.builders.scene import box_room

TABLE = ((-1.5, -0.5), (1.5, -0.5), (1.5, 0.5), (-1.5, 0.5))
BY_SURFACE = Goal((0.0, 0.0), 1.0, TABLE)
BY_CENTROID = Goal((0.0, 0.0), 1.0)


@pytest.mark.parametrize(
    ("point", "distance"),
    [((3.0, 0.0), 1.5), ((0.0, -2.0), 1.5), ((2.5, 1.5), math.sqrt(2)), ((1.5, 0.2), 0.0), ((0.3, -0.1), 0.0)],
)
def test_distance_to_a_footprint_is_that_to_its_nearest_side_or_corner_and_zero_inside(
    point: tuple[float, float], distance: float
) -> None:
    assert BY_SURFACE.distance(*point) == pytest.approx(distance)
    assert BY_SURFACE.distances([point, point]).tolist() == pytest.approx([distance] * 2)


@pytest.mark.parametrize("footprint", [((1.0, 2.0),), ((0.0, 0.0), (2.0, 0.0))])
def test_the_distance_beyond_the_end_of_a_footprint_without_area_is_that_to_its_end(
    footprint: tuple[tuple[float, float], ...],
) -> None:
    x, y = footprint[-1]
    assert footprint_distances([(x + 3.0, y), (x, y)], footprint).tolist() == [3.0, 0.0]


@pytest.mark.parametrize("goal", [BY_SURFACE, BY_CENTROID])
def test_approach_ends_at_the_given_distance_on_the_line_to_the_centroid_and_keeps_nearer_starts(goal: Goal) -> None:
    starts = np.array([[4.0, 0.0], [3.0, 4.0], [0.0, -3.0], [0.1, 0.2]])
    ends = goal.approach(starts, 0.97)
    assert goal.distances(ends[:3]) == pytest.approx(0.97, abs=1e-6)
    turned = starts[:3, 0] * ends[:3, 1] - starts[:3, 1] * ends[:3, 0]
    assert np.abs(turned).max() < 1e-9
    assert ends[3].tolist() == starts[3].tolist()


@pytest.mark.parametrize("goal", [BY_SURFACE, BY_CENTROID])
def test_a_ring_is_at_one_distance_in_the_given_directions(goal: Goal) -> None:
    angle = np.linspace(0, 2 * math.pi, 24)
    rays = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = goal.ring(rays, 2.5)
    assert goal.distances(points) == pytest.approx(2.5, abs=1e-6)
    assert points / np.linalg.norm(points, axis=1)[:, None] == pytest.approx(rays, abs=1e-9)
    assert goal.distances(goal.outline()) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("goal", [BY_SURFACE, BY_CENTROID])
def test_rings_computed_at_once_equal_single_rings_bit_for_bit(goal: Goal) -> None:
    angle = np.linspace(0.0, 2 * np.pi, 48, endpoint=False)
    rays, distances = np.stack([np.cos(angle), np.sin(angle)], axis=1), np.array([0.3, 1.5, 2.5])
    at_once = goal.ring(np.tile(rays, (3, 1)), np.repeat(distances, 48))
    assert np.array_equal(at_once, np.concatenate([goal.ring(rays, distance) for distance in distances]))


@pytest.mark.parametrize("footprint", [TABLE, ((0.0, 0.0), (2.0, 0.1), (0.5, 1.0)), TABLE[:2], TABLE[:1]])
@pytest.mark.parametrize("distance", [-0.1, 0.0, 0.97])
def test_approach_equals_a_bisection_in_36_steps_bit_for_bit(
    footprint: tuple[tuple[float, float], ...], distance: float
) -> None:
    centre = np.mean(footprint, axis=0)
    goal = Goal((float(centre[0]), float(centre[1])), 1.0, footprint)
    starts = np.random.default_rng(4).normal(centre, 3.0, size=(60, 2))
    for start, end in zip(starts, goal.approach(starts, distance), strict=True):
        low, high = 0.0, 1.0
        for _ in range(36):
            middle = (low + high) / 2
            is_near = goal.distances(centre + (start - centre) * middle) <= distance
            low, high = (middle, high) if is_near else (low, middle)
        expected = start if goal.distances(start) <= distance else centre + (start - centre) * low
        assert end.tolist() == expected.tolist()


def test_the_shortest_way_into_the_goal_leads_to_the_nearest_side() -> None:
    gap, end = BY_SURFACE.entry(np.array([1.2, 3.5]))
    assert gap == pytest.approx(2.0)
    assert end.tolist() == pytest.approx([1.2, 1.5])


def test_the_surface_measure_is_refused_for_a_target_without_footprint_with_both_remedies() -> None:
    target = box_room().info.targets[0].model_copy(update={"footprint_m": ()})
    assert Goal.of(target, TaskConfig()).distance(*target.centroid_m[:2]) == 0.0
    with pytest.raises(WorldError, match=r"factory scene build.*task\.success = \"centroid\""):
        Goal.of(target, TaskConfig(success=SuccessMeasure.SURFACE))


@pytest.mark.parametrize(
    ("far_m", "other_id", "nothing"),
    [(2.0, 0, True), (2.03, 0, True), (2.2, 0, False), (2.0, 7, False), (0.0, 0, True)],
)
def test_a_frame_of_one_flat_surface_shows_nothing(far_m: float, other_id: int, nothing: bool) -> None:
    depth, ids = np.full((4, 4), min(2.0, far_m), np.float32), np.zeros((4, 4), np.uint16)
    depth[3, 3], ids[0, 0] = far_m, other_id
    assert shows_nothing(depth, ids) is nothing
