"""Measures of a drive, compared with manually computed cases."""

from __future__ import annotations

import numpy as np
import pytest

from factory.eval.driving import measure
from factory.eval.driving.rollout import progresses
from schemas.config import TaskConfig
from schemas.measure import Goal
from schemas.scene import Target
from tests.builders.scene import box_room
from workers.geometry.grid import Grid

TASK = TaskConfig()
CRATE = box_room().info.targets[0]


def track_through(*points: tuple[float, float], stand: int = 0) -> np.ndarray:
    rows = [*points, *[points[-1]] * stand]
    return np.array(rows, float)


def test_spl_is_the_ratio_of_shortest_to_driven_length_and_zero_without_success() -> None:
    assert measure.spl(True, 4.0, 5.0) == pytest.approx(0.8)
    assert measure.spl(True, 4.0, 3.9) == 1.0  # the shortest path is approximate, so a drive can be shorter
    assert measure.spl(False, 4.0, 4.0) == 0.0
    assert measure.spl(True, 0.0, 0.0) == 1.0


def test_soft_spl_replaces_success_by_progress() -> None:
    assert measure.soft_spl(4.0, 1.0, 5.0) == pytest.approx(0.75 * 0.8)
    assert measure.soft_spl(4.0, 6.0, 5.0) == 0.0  # farther away than at the start
    assert measure.soft_spl(4.0, 0.0, 4.0) == 1.0


def test_progress_is_the_covered_share_of_the_start_distance() -> None:
    assert measure.progress(4.0, 1.0) == pytest.approx(0.75)
    assert measure.progress(4.0, 5.0) == pytest.approx(-0.25)


def test_progress_is_measured_at_the_end_and_at_the_closest_point_and_normalised_to_the_circle() -> None:
    found = progresses(start_m=4.0, final_m=3.0, least_m=2.0, task=TASK)
    assert found == pytest.approx({"progress_final": 0.25, "progress_max": 0.5, "progress_normalised": 2 / 3})
    assert progresses(4.0, 0.9, 0.9, TASK)["progress_normalised"] == 1.0
    assert progresses(0.5, 0.5, 0.5, TASK)["progress_normalised"] == 1.0  # starts inside


def test_path_length_adds_up_the_steps_in_the_plane() -> None:
    assert measure.path_length_m(track_through((0, 0), (3, 4), (3, 5))) == pytest.approx(6.0)


@pytest.mark.parametrize(
    ("stand", "at", "stopped"),
    [(5, (0.9, 0.0), True), (4, (0.9, 0.0), False), (9, (1.1, 0.0), False), (5, (1.0, 0.0), True)],
)
def test_a_stop_counts_if_it_is_inside_the_radius_and_lasts_five_frames(
    stand: int, at: tuple[float, float], stopped: bool
) -> None:
    track = track_through((2.0, 0.0), at, stand=stand)
    assert measure.has_stopped_at(track, Goal((0.0, 0.0), 1.0), TASK) is stopped


def test_driving_through_the_circle_does_not_count_as_a_stop() -> None:
    track = np.column_stack((np.linspace(-2, 2, 300), np.zeros(300)))
    assert not measure.has_stopped_at(track, Goal((0.0, 0.0), 1.0), TASK)


def test_any_instance_success_counts_only_objects_of_the_category() -> None:
    other = CRATE.model_copy(update={"target_id": "crate_99", "centroid_m": (-2.0, 0.0, 0.3)})
    track = track_through((0.0, 0.0), (-1.2, 0.0), stand=6)
    assert measure.stops_at_any(track, (CRATE, other), "crate", TASK)
    assert not measure.stops_at_any(track, (CRATE, other), "barrel", TASK)
    assert not measure.stops_at_any(track, (CRATE,), "crate", TASK)


def test_floor_distance_starts_at_the_nearest_floor_beside_a_wall_and_is_none_outside_of_the_room() -> None:
    grid = Grid.from_scene(box_room())
    open_floor = measure.floor_distance_m(grid, (0.0, 0.0), CRATE, TASK)
    straight = float(np.hypot(*np.array(CRATE.centroid_m[:2]))) - 1.0
    assert open_floor == pytest.approx(straight, abs=0.1)
    beside = measure.floor_distance_m(grid, (-3.9, 0.0), CRATE, TASK)  # at 10 cm from the wall, the field is empty
    assert beside is not None
    assert beside > 3.9
    assert measure.floor_distance_m(grid, (-8.0, 0.0), CRATE, TASK) is None


def test_a_target_without_connected_floor_has_no_path() -> None:
    far = Target(
        target_id="crate_9",
        category="crate",
        instance_id=1,
        prim_path="/x",
        centroid_m=(50.0, 50.0, 0.0),
        size_m=(1.0, 1.0, 1.0),
    )
    assert measure.floor_distance_m(Grid.from_scene(box_room()), (0.0, 0.0), far, TASK) is None
