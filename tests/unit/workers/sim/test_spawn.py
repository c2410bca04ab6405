"""Start poses on the grid: distances are uniform even where bearings are blocked, and every start is in its tier."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from schemas.config import SpawnConfig, TaskConfig
from schemas.instruction.start_view import StartView
from schemas.job import Job
from schemas.measure import Goal
from schemas.terms import ExpertName, Screening, Tier
from tests.builders.bundle import job_for
from tests.builders.scene import Box, build_scene, room_walls
from workers.geometry.mask_estimate import MaskEstimate
from workers.geometry.pose import Pose
from workers.planning import geodesic_m
from workers.sim.context import LoadedScene, prepare_scene
from workers.sim.spawn import draw_poses, predict_path

CRATE = Box((-0.3, -0.3, 0.0), (0.3, 0.3, 0.6), category="crate")


def lane_room(length_m: float) -> LoadedScene:
    """A room of 2 m width with a crate near one end."""
    return prepare_scene(build_scene((*room_walls((-1.0, -1.0), (length_m, 1.0)), CRATE)))


def crate_job(place: LoadedScene, attempt: int = 1, tier: Tier = Tier.MID, **changes: Any) -> Job:
    values: dict[str, Any] = {
        "task": TaskConfig(),
        "tier": tier,
        "attempt": attempt,
        "target_id": place.compiled.info.targets[0].target_id,
    }
    return job_for(**values | changes)


def first_start(place: LoadedScene, job: Job) -> Pose | None:
    return next(iter(draw_poses(job, place.compiled.info.target(job.target_id), place, job.rng())), None)


def distances(place: LoadedScene, count: int, **changes: Any) -> list[float]:
    starts = [first_start(place, crate_job(place, attempt, **changes)) for attempt in range(1, count + 1)]
    return [math.hypot(start.x, start.y) for start in starts if start is not None]


def test_distances_stay_uniform_although_only_a_narrow_lane_leads_to_the_target() -> None:
    found = distances(lane_room(8.5), 400)
    assert len(found) == 400
    assert abs(np.mean(found) - 5.25) < 0.15
    quarters = np.histogram(found, bins=4, range=(3.5, 7.0))[0]
    assert quarters.min() >= 75


def test_a_distance_without_a_start_is_drawn_again() -> None:
    found = distances(lane_room(5.6), 60)
    assert len(found) == 60
    assert max(found) < 5.2


@pytest.mark.parametrize("expert", [ExpertName.PROPORTIONAL, ExpertName.PLANNER])
def test_near_starts_face_the_target_within_the_heading_noise(expert: ExpertName) -> None:
    place = lane_room(8.5)
    for attempt in range(1, 40):
        job = crate_job(place, attempt, Tier.NEAR, expert=expert)
        start = first_start(place, job)
        assert start is not None
        assert 1.5 <= math.hypot(start.x, start.y) <= 3.5
        off = math.remainder(math.atan2(-start.y, -start.x) - start.yaw, 2 * math.pi)
        assert abs(off) <= job.spawn.heading_noise_rad + 1e-9


@pytest.mark.parametrize("expert", [ExpertName.PROPORTIONAL, ExpertName.PLANNER])
def test_no_start_is_below_a_shelf_on_legs(expert: ExpertName) -> None:
    shelf = Box((2.0, -1.0, 1.5), (3.0, 1.0, 1.7), category="shelf")
    room = (*room_walls((-1.0, -1.0), (8.5, 1.0)), CRATE)
    for place, is_beneath in (
        (prepare_scene(build_scene(room)), True),
        (prepare_scene(build_scene((*room, shelf))), False),
    ):
        jobs = [crate_job(place, attempt, Tier.NEAR, expert=expert) for attempt in range(1, 40)]
        starts = [start for job in jobs if (start := first_start(place, job)) is not None]
        assert len(starts) == 39
        assert any(2.0 < start.x < 3.0 for start in starts) == is_beneath


def test_a_tier_without_floor_has_no_start() -> None:
    place = lane_room(3.4)
    assert first_start(place, crate_job(place)) is None


def test_the_same_attempt_starts_at_the_same_pose() -> None:
    place = lane_room(8.5)
    assert first_start(place, crate_job(place, 3)) == first_start(place, crate_job(place, 3))
    assert first_start(place, crate_job(place, 3)) != first_start(place, crate_job(place, 4))


def pillared_room() -> LoadedScene:
    """An open room with a crate in a ring of pillars of 2.4 m radius; the passages between the pillars are narrow."""
    angles = 2 * np.pi * np.arange(10) / 10
    spots = [(2.4 * math.cos(angle), 2.4 * math.sin(angle)) for angle in angles]
    pillars = [Box((x - 0.15, y - 0.15, 0.0), (x + 0.15, y + 0.15, 2.0)) for x, y in spots]
    return prepare_scene(build_scene((*room_walls((-9.0, -9.0), (9.0, 9.0)), CRATE, *pillars)))


def is_drive_free(place: LoadedScene, job: Job, start: tuple[float, float, float]) -> bool:
    target = place.compiled.info.target(job.target_id)
    x, y, yaw = predict_path(
        start, Goal.of(target, job.task), job, MaskEstimate(place.compiled, target.instance_id, job.camera)
    ).T
    return bool(place.grid.are_poses_free(x, y, yaw, 0.10).all())


def test_straight_experts_start_where_the_predicted_drive_is_free() -> None:
    place = pillared_room()
    job = crate_job(place)
    ring = 2 * np.pi * np.arange(720) / 720
    points = 5.0 * np.stack([np.cos(ring), np.sin(ring)], axis=1)
    lines = place.grid.are_lines_free(points, 0.97 * points / 5.0, job.spawn.approach_clearance_m)
    off = job.spawn.heading_noise_rad
    drives = [is_drive_free(place, job, (x, y, math.atan2(-y, -x) + off)) for x, y in points[lines]]
    assert 0 < sum(drives) < len(drives)  # the drive is free from some of the candidates only
    for attempt in range(1, 60):
        tried = crate_job(place, attempt)
        start = first_start(place, tried)
        assert start is not None
        assert is_drive_free(place, tried, (start.x, start.y, start.yaw))


def test_if_no_path_is_wide_enough_the_widest_one_is_chosen() -> None:
    walls = (Box((1.2, -1.0, 0.0), (8.0, -0.45, 2.0)), Box((1.2, 0.45, 0.0), (8.0, 1.0, 2.0)))
    place = prepare_scene(build_scene((*room_walls((-1.0, -1.0), (8.5, 1.0)), CRATE, *walls)))
    jobs = [crate_job(place, attempt) for attempt in range(1, 20)]
    starts = [first_start(place, job) for job in jobs]
    found = [(start.x, start.y, start.yaw) for start in starts if start is not None]
    assert len(found) == len(jobs)
    assert not all(is_drive_free(place, job, start) for job, start in zip(jobs, found, strict=True))
    assert np.abs([y for _, y, _ in found]).mean() < 0.05  # the starts are near the centre line of the lane


def screened(screening: Screening, **changes: Any) -> dict[str, Any]:
    return {"spawn": SpawnConfig(screening=screening, **changes)}


def starts_of(place: LoadedScene, attempts: int, **changes: Any) -> list[tuple[float, float, float]]:
    jobs = [crate_job(place, attempt, **changes) for attempt in range(1, attempts + 1)]
    starts = [first_start(place, job) for job in jobs]
    return [(start.x, start.y, start.yaw) for start in starts if start is not None]


def divided_room() -> LoadedScene:
    """A wide room whose crate is close to a wall with a door, with floor behind the wall."""
    wall = (Box((-9.0, 1.2, 0.0), (4.0, 1.4, 2.5)), Box((5.2, 1.2, 0.0), (9.0, 1.4, 2.5)))
    return prepare_scene(build_scene((*room_walls((-9.0, -9.0), (9.0, 9.0)), CRATE, *wall)))


def is_line_free(place: LoadedScene, start: tuple[float, float, float]) -> bool:
    x, y, _ = start
    distance = math.hypot(x, y)
    return place.grid.is_line_free((x, y), (0.97 * x / distance, 0.97 * y / distance), 0.10)


@pytest.mark.parametrize("tier", [Tier.NEAR, Tier.MID])
def test_blind_starts_are_behind_walls_in_proportion_to_the_free_floor_there(tier: Tier) -> None:
    place = divided_room()
    starts = starts_of(place, 60, tier=tier, **screened(Screening.NONE))
    assert len(starts) == 60
    behind = np.mean([y > 1.4 for _, y, _ in starts])
    assert 0.1 < behind < 0.5
    free = starts_of(place, 15, tier=tier, **screened(Screening.FREE_LINE))
    assert len(free) == 15
    assert all(is_line_free(place, start) for start in free)


@pytest.mark.parametrize("tier", [Tier.NEAR, Tier.MID])
def test_starts_with_screening_sight_see_the_target_with_or_without_a_free_line(tier: Tier) -> None:
    wall = (Box((-9.0, 1.2, 0.0), (4.0, 1.4, 2.5)), Box((5.2, 1.2, 0.0), (9.0, 1.4, 2.5)))
    bench = Box((-1.2, -0.9, 0.0), (1.2, -0.7, 0.4))  # lower than the line of sight
    place = prepare_scene(build_scene((*room_walls((-9.0, -9.0), (9.0, 9.0)), CRATE, *wall, bench)))
    starts = starts_of(place, 40, tier=tier, **screened(Screening.SIGHT))
    assert len(starts) == 40
    target = place.compiled.info.targets[0]
    assert all(place.grid.has_sight(start[:2], target) for start in starts)
    assert 0 < sum(is_line_free(place, start) for start in starts) < 40


def test_far_starts_with_screening_sight_equal_those_without_screening() -> None:
    place = divided_room()
    blind, sight = (
        starts_of(place, 12, tier=Tier.FAR, **screened(screening)) for screening in (Screening.NONE, Screening.SIGHT)
    )
    assert blind == sight


def test_starts_with_a_free_line_need_no_free_predicted_drive() -> None:
    place = pillared_room()
    starts = starts_of(place, 40, **screened(Screening.FREE_LINE))
    assert len(starts) == 40
    assert all(is_line_free(place, start) for start in starts)
    assert not all(is_drive_free(place, crate_job(place), start) for start in starts)


@pytest.mark.parametrize(
    ("expert", "screening"),
    [
        (ExpertName.PROPORTIONAL, Screening.NONE),
        (ExpertName.PROPORTIONAL, Screening.FREE_LINE),
        (ExpertName.PROPORTIONAL, Screening.FORESEEN),
        (ExpertName.PLANNER, Screening.FORESEEN),
    ],
)
def test_far_starts_are_within_the_planned_range_of_floor_distances(expert: ExpertName, screening: Screening) -> None:
    place = divided_room()
    target = place.compiled.info.targets[0]
    detours = []
    for low, high in ((5.0, 11.0), (5.5, 7.0)):
        spawn = screened(screening, far_floor_m=(low, high))
        starts = starts_of(place, 24, tier=Tier.FAR, expert=expert, **spawn)
        assert len(starts) == 24
        ways = [geodesic_m(place.grid, start[:2], target, TaskConfig()) for start in starts]
        floor_m = [1.0 + way for way in ways if way is not None]
        assert len(floor_m) == 24
        assert low <= min(floor_m)
        assert max(floor_m) <= high
        detours += [floor - math.hypot(x, y) for floor, (x, y, _) in zip(floor_m, starts, strict=True)]
    assert (max(detours) > 0.05) == (screening is Screening.NONE or expert is ExpertName.PLANNER)


def test_a_room_of_three_metres_has_no_far_start() -> None:
    place = lane_room(3.4)
    assert first_start(place, crate_job(place, tier=Tier.FAR, **screened(Screening.NONE))) is None


def test_all_blind_attempts_at_an_episode_start_at_the_same_distance() -> None:
    place = lane_room(8.5)
    blind, foreseen = (
        [distances(place, 3, index=index, **screened(screening)) for index in range(1, 20)]
        for screening in (Screening.SIGHT, Screening.FORESEEN)
    )
    assert all(max(found) - min(found) < 1e-9 for found in blind)
    assert all(max(found) - min(found) > 1e-3 for found in foreseen)
    assert np.std([found[0] for found in blind]) > 0.6  # the distances of the episodes spread over the tier


@pytest.mark.parametrize("expert", [ExpertName.PROPORTIONAL, ExpertName.PLANNER])
@pytest.mark.parametrize("tier", Tier)
def test_a_further_condition_selects_among_the_same_candidates(expert: ExpertName, tier: Tier) -> None:
    place = lane_room(8.5)
    job = crate_job(place, tier=tier, expert=expert)
    target = place.compiled.info.target(job.target_id)
    seen: list[Pose] = []

    def is_on_the_left(pose: Pose) -> bool:
        seen.append(pose)
        return pose.y > 0.1

    found = next(draw_poses(job, target, place, job.rng(), is_on_the_left))
    assert found.y > 0.1
    assert found in seen
    again = next(draw_poses(job, target, place, job.rng(), lambda pose: pose == found))
    assert again == found


def test_a_draw_ends_when_too_many_starts_are_rejected() -> None:
    place = lane_room(8.5)
    job = crate_job(place, expert=ExpertName.PLANNER)
    rejected: list[Pose] = []
    target = place.compiled.info.target(job.target_id)
    assert list(draw_poses(job, target, place, job.rng(), lambda pose: bool(rejected.append(pose)))) == []
    assert 256 <= len(rejected) < 256 + 32


@pytest.mark.parametrize(
    ("view", "limit_deg"), [(StartView(within_rad=0.5), 28.65), (StartView(other_referents=(99,)), 45.0)]
)
def test_far_starts_that_must_show_the_target_head_towards_it(view: StartView, limit_deg: float) -> None:
    place = lane_room(8.5)
    for attempt in range(1, 30):
        job = crate_job(place, attempt, Tier.FAR, start_view=view)
        start = first_start(place, job)
        assert start is not None
        off = math.remainder(math.atan2(-start.y, -start.x) - start.yaw, 2 * math.pi)
        assert abs(math.degrees(off)) <= limit_deg + 0.01
