"""Start poses on the grid: distances stay uniform where bearings are blocked, and every start keeps to its tier."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from schemas.config import TaskConfig
from schemas.job import Job
from schemas.terms import ExpertName, Tier
from tests.builders.bundle import job_for
from tests.builders.scene import Box, build_scene, room_walls
from workers.pose import Pose
from workers.spawn import draw_poses
from workers.stage import LoadedScene, prepare_scene

CRATE = Box((-0.3, -0.3, 0.0), (0.3, 0.3, 0.6), category="crate")


def lane_room(length_m: float) -> LoadedScene:
    """A room of two metres' width whose crate stands near one end."""
    return prepare_scene(build_scene((*room_walls((-1.0, -1.0), (length_m, 1.0)), CRATE)))


def crate_job(place: LoadedScene, attempt: int = 1, tier: Tier = Tier.MID, **changes: Any) -> Job:
    values: dict[str, Any] = {
        "task": TaskConfig(),
        "tier": tier,
        "attempt": attempt,
        "target_id": place.scene.info.targets[0].target_id,
    }
    return job_for(**values | changes)


def first_start(place: LoadedScene, job: Job) -> Pose | None:
    return next(iter(draw_poses(job, place.scene.info.target(job.target_id), place, job.rng())), None)


def distances(place: LoadedScene, count: int, **changes: Any) -> list[float]:
    starts = [first_start(place, crate_job(place, attempt, **changes)) for attempt in range(1, count + 1)]
    return [math.hypot(start.x, start.y) for start in starts if start is not None]


def test_distances_stay_uniform_although_only_a_narrow_lane_leads_to_the_target() -> None:
    found = distances(lane_room(8.5), 400)
    assert len(found) == 400
    assert abs(np.mean(found) - 5.25) < 0.15
    quarters = np.histogram(found, bins=4, range=(3.5, 7.0))[0]
    assert quarters.min() >= 75


def test_a_distance_that_the_scene_lacks_is_drawn_anew() -> None:
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


def test_there_is_no_start_where_the_tier_has_no_floor() -> None:
    place = lane_room(3.4)
    assert first_start(place, crate_job(place)) is None


def test_the_same_attempt_starts_at_the_same_pose() -> None:
    place = lane_room(8.5)
    assert first_start(place, crate_job(place, 3)) == first_start(place, crate_job(place, 3))
    assert first_start(place, crate_job(place, 3)) != first_start(place, crate_job(place, 4))
