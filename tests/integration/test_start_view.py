"""Start views without other objects that fit the instruction: the worker draws such starts, validation checks them."""

from __future__ import annotations

import hashlib
import io
import math
from pathlib import Path

import numpy as np
import pytest

from coordinator.validation.start import start_findings
from coordinator.validation.validate import validate
from schemas.bundle import BundleReader
from schemas.config import CameraConfig, RobotConfig, TaskConfig
from schemas.instruction.referents import ids_in_view, referents_of
from schemas.instruction.start_view import StartView, start_view_findings
from schemas.job import Job
from schemas.scene import encode_scene
from schemas.terms import ExpertName, Tier
from tests.builders.bundle import job_for
from tests.builders.scene import Box, build_scene, room_walls
from workers.geometry.pose import Pose
from workers.render import PartialRenderer
from workers.sim.attempt import AttemptFailure, Success, is_view_clear, run_attempt
from workers.sim.context import SimulationContext

LEFT = Box((1.2, 0.9, 0.0), (1.8, 1.5, 0.6), (200, 30, 30), category="crate")
RIGHT = Box((1.2, -1.5, 0.0), (1.8, -0.9, 0.6), (30, 30, 200), category="crate")
SCENE = build_scene((*room_walls((-4.0, -4.0), (4.0, 4.0)), LEFT, RIGHT))
TARGET, RIVAL = SCENE.info.targets
PACKAGE = encode_scene(SCENE, level=1)


def _job(attempt: int, view: StartView | None, tier: Tier = Tier.NEAR) -> Job:
    return job_for(
        attempt=attempt,
        scene=SCENE.info.name,
        scene_sha256=hashlib.sha256(PACKAGE).hexdigest(),
        tier=tier,
        category="crate",
        instruction="Go to the crate.",
        target_id=TARGET.target_id,
        expert=ExpertName.PLANNER,
        task=TaskConfig(control_hz=15, success_radius_m=1.4, hold_steps=2),
        robot=RobotConfig(physics_substeps=16, max_braking_mps2=4.0),
        start_view=view,
    )


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    path: Path = tmp_path_factory.mktemp("scene") / "room.scene"
    path.write_bytes(PACKAGE)
    with SimulationContext() as stage:
        stage.load(path, hashlib.sha256(PACKAGE).hexdigest())
        yield stage


def _episode(stage: SimulationContext, view: StartView | None, tier: Tier = Tier.NEAR) -> BundleReader:
    """Returns the first successful attempt."""
    for attempt in range(1, 8):
        file = io.BytesIO()
        if isinstance(run_attempt(_job(attempt, view, tier), stage, file, "host-1", lambda _: None), Success):
            return BundleReader(file)
    raise AssertionError("no attempt succeeds")


@pytest.mark.parametrize("tier", [Tier.NEAR, Tier.FAR])
def test_the_first_frame_shows_the_target_and_no_other_object_that_the_instruction_fits(stage, tier):
    with _episode(stage, StartView(other_referents=(RIVAL.instance_id,)), tier) as bundle:
        shown = ids_in_view(bundle.ids(0), bundle.meta.job.gains.min_mask_px)
        assert shown & referents_of(bundle.meta.job, SCENE.info) == {TARGET.instance_id}
        assert not bundle.meta.phrase_is_unique
        assert validate(bundle, bundle.meta.job, (TARGET,)) == []


def test_a_start_that_shows_both_objects_is_refused_for_a_job_with_conditions(stage):
    for attempt in range(1, 8):
        file = io.BytesIO()
        outcome = run_attempt(_job(attempt, None), stage, file, "host-1", lambda _: None)
        with BundleReader(file) as bundle:
            if isinstance(outcome, Success) and np.count_nonzero(bundle.ids(0) == RIVAL.instance_id) >= 32:
                claimed = bundle.meta.job.model_copy(
                    update={"start_view": StartView(other_referents=(RIVAL.instance_id,))}
                )
                assert validate(bundle, bundle.meta.job, (TARGET,)) == []
                found = start_findings(
                    bundle.meta.model_copy(update={"job": claimed}), bundle.arrays, bundle.ids(0), bundle.depth(0)
                )
                assert found == [
                    f"start: objects [{RIVAL.instance_id}] are in view, and the instruction fits them as well"
                ]
                return
    raise AssertionError("no start shows both objects")


def test_an_attempt_without_a_start_that_meets_the_conditions_fails_with_the_reason_spawn(stage):
    walls = tuple(range(1, 1 + len(room_walls((-4.0, -4.0), (4.0, 4.0)))))
    outcome = run_attempt(_job(1, StartView(other_referents=walls)), stage, io.BytesIO(), "host-1", lambda _: None)
    assert isinstance(outcome, AttemptFailure)
    assert outcome.reason == "spawn"
    assert "whose view meets the conditions" in outcome.detail


class _PartsOnly:
    """Renderer that can only render single instances."""

    def __init__(self, renderer: PartialRenderer) -> None:
        self.render_instance, self.count_within = renderer.render_instance, renderer.count_within


@pytest.mark.parametrize(
    "view",
    [
        StartView(),
        StartView(within_rad=0.5),
        StartView(other_referents=(RIVAL.instance_id,)),
        StartView(same_category=(RIVAL.instance_id,)),
        StartView(same_category=(RIVAL.instance_id,), least_same_category=1),
        StartView(same_category=(RIVAL.instance_id,), least_same_category=1, ranks=(0.2, 0.9)),
    ],
)
def test_the_check_of_a_start_view_agrees_with_the_findings_of_the_whole_image(stage, view):
    stage.renderer.load(SCENE, CameraConfig())
    job = _job(1, view)
    for yaw in np.linspace(-math.pi, math.pi, 24, endpoint=False).tolist():
        pose = Pose.planar(-1.0, 0.3, yaw, z=0.0)
        bearing = math.remainder(math.atan2(1.2 - pose.y, 1.5 - pose.x) - yaw, 2 * math.pi)
        image, least = stage.renderer.render_depth_and_ids(pose), job.gains.min_mask_px
        found = start_view_findings(view, TARGET.instance_id, bearing, image.ids, image.depth, CameraConfig(), least)
        assert is_view_clear(job, SCENE.info, stage.renderer, pose) == (not found)


@pytest.mark.parametrize("yaw", [math.pi, -1.0, 0.2])
def test_no_whole_image_is_rendered_for_the_view_of_one_object(stage, yaw):
    stage.renderer.load(SCENE, CameraConfig())
    job, pose = _job(1, StartView(within_rad=math.pi)), Pose.planar(-1.0, 0.3, yaw, z=0.0)
    assert is_view_clear(job, SCENE.info, _PartsOnly(stage.renderer), pose) == is_view_clear(
        job, SCENE.info, stage.renderer, pose
    )
