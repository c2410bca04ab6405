"""The planner expert in real physics: drives around a wall to its target without contact."""

from __future__ import annotations

from types import TracebackType
from typing import Self

import numpy as np
import pytest

from coordinator.validation.motion import motion_findings
from schemas.config import CameraConfig, DemonstrationConfig, PlannerConfig, TaskConfig
from schemas.frame import Frame
from schemas.job import Job
from schemas.scene import CompiledScene
from schemas.support.geometry import footprint_distances, yaw_of
from schemas.terms import EndReason, ExpertName, SuccessMeasure, Tier
from tests.builders.bundle import job_for
from tests.builders.scene import Box, box_room
from workers.experts import make_expert
from workers.geometry.grid import Grid
from workers.geometry.pose import Pose
from workers.physics.world import ColliderMesh, World
from workers.planning import geodesic_m
from workers.render import DepthAndIds
from workers.sim.context import prepare_scene
from workers.sim.rollout import Drive, drive
from workers.sim.spawn import draw_poses

WALL = Box((0.8, -1.0, 0.0), (1.0, 3.0, 2.5))
FENCE = Box((0.8, -3.0, 0.0), (1.0, 3.0, 2.5))
DARK = Frame(np.zeros((8, 8, 3), np.uint8), np.zeros((8, 8), np.float32), np.zeros((8, 8), np.uint16))


class EmptyRenderer:
    """A renderer that returns empty frames: the planner uses no images."""

    description = "darkness"

    def load(self, scene: CompiledScene, camera: CameraConfig) -> None: ...

    def render(self, pose: Pose) -> Frame:
        return DARK

    def render_depth_and_ids(self, pose: Pose) -> DepthAndIds:
        return DepthAndIds(DARK.depth, DARK.ids)

    def close(self) -> None: ...

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def planner_job(scene: CompiledScene, tier: Tier = Tier.FAR, **changes: object) -> Job:
    crate = next(target for target in scene.info.targets if target.category == "crate")
    values = {"tier": tier, "expert": ExpertName.PLANNER, "task": TaskConfig(), "target_id": crate.target_id}
    return job_for(**values | changes)


def drive_from(
    scene: CompiledScene, start: tuple[float, float, float], known: Grid | None = None, **changes: object
) -> Drive:
    job = planner_job(scene, **changes)
    target = scene.info.target(job.target_id)
    with World(scene, ColliderMesh.from_scene(scene), job.robot, job.task.control_hz) as world:
        world.place(*start)
        expert = make_expert(job)
        assert expert.begin(world.pose(), known or Grid.from_scene(scene), target)
        return drive(job, target, world, EmptyRenderer(), expert, lambda _frame: None, lambda _step: None)


@pytest.mark.parametrize("start", [(-1.5, 0.5, 0.0), (-1.0, 0.0, 2.8), (-2.5, 1.5, -1.6)])
def test_the_planner_drives_around_a_wall_and_stops_without_contact(start):
    scene = box_room([WALL])
    done = drive_from(scene, start)
    assert done.end_reason is EndReason.SUCCESS, done.end
    assert done.contact_steps == 0
    end = done.arrays.poses[-1, :2]
    assert 0.85 < np.linalg.norm(end - [2.5, 1.3]) < 1.0
    assert done.arrays.actions_continuous[:, 0].min() >= 0.0
    job = planner_job(scene)
    assert motion_findings(done.arrays, job.robot, job.task.control_hz, done.contact_steps) == []


def test_two_runs_of_the_same_drive_are_bit_identical():
    first, second = (drive_from(box_room([WALL]), (-1.5, 0.5, 0.0)) for _ in range(2))
    assert np.array_equal(first.arrays.poses, second.arrays.poses)


def test_planner_finds_no_path_through_a_fence():
    scene = box_room([FENCE])
    job = planner_job(scene)
    expert = make_expert(job)
    assert expert.begin(Pose.planar(-1.5, 0.0, 0.0), Grid.from_scene(scene), scene.info.target(job.target_id)) is None
    assert list(draw_poses(job, scene.info.target(job.target_id), prepare_scene(scene), job.rng())) == []


def test_far_starts_of_the_planner_may_be_behind_walls_within_the_distance_limit():
    scene = box_room([WALL])
    place = prepare_scene(scene)
    target = scene.info.target(planner_job(scene).target_id)
    starts = []
    for attempt in range(1, 30):
        job = planner_job(scene, attempt=attempt, planner=PlannerConfig(max_path_m=4.5))
        starts += list(draw_poses(job, target, place, job.rng()))
    ways = [geodesic_m(place.grid, (start.x, start.y), target, TaskConfig()) for start in starts]
    assert starts
    assert max(way for way in ways if way is not None) <= 4.6
    assert None not in ways
    assert any(not place.grid.has_sight((start.x, start.y), target) for start in starts)


def test_a_planner_that_must_show_the_target_stops_with_the_target_ahead():
    scene = box_room([WALL])
    job = planner_job(scene, demonstration=DemonstrationConfig(target_in_view=True))
    done = drive_from(scene, (-1.0, 0.0, 2.8), demonstration=job.demonstration)
    assert done.end_reason is EndReason.NOT_IN_VIEW, done.end  # the images of the renderer are empty
    x, y = done.arrays.poses[-1, :2].tolist()
    bearing = np.arctan2(1.3 - y, 2.5 - x)
    assert abs(np.remainder(bearing - float(yaw_of(done.arrays.poses)[-1]) + np.pi, 2 * np.pi) - np.pi) < 0.7


def test_a_drive_with_the_surface_measure_stops_within_a_metre_of_the_footprint():
    scene = box_room([Box((-1.0, -2.6, 0.0), (3.0, -0.6, 0.7), category="table")])
    table = next(target for target in scene.info.targets if target.category == "table")
    task = TaskConfig(success=SuccessMeasure.SURFACE)
    done = drive_from(scene, (-3.0, 1.8, 0.0), task=task, target_id=table.target_id)
    assert done.end_reason is EndReason.SUCCESS, done.end
    left = footprint_distances(done.arrays.poses[-1, :2], table.footprint_m)
    assert 0.85 < left < 1.0


def test_contacts_beyond_the_limit_end_the_attempt_and_are_only_counted_if_there_is_no_limit():
    plank = Box((-2.6, 0.245, 0.0), (-1.0, 0.4, 0.6))  # overlaps the robot's path by 5 mm; the planner's map omits it
    scene, start, known = box_room([plank]), (-2.0, 0.0, 0.0), Grid.from_scene(box_room())
    free = drive_from(scene, start, known)
    assert free.contact_steps > 0
    assert free.end_reason is not EndReason.CONTACT
    limited = drive_from(scene, start, known, demonstration=DemonstrationConfig(max_contact_steps=0))
    assert limited.end_reason is EndReason.CONTACT
    assert limited.contact_steps == 1
    assert len(limited.arrays.poses) < len(free.arrays.poses)
