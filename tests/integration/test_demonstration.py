"""Checks the requirements on a demonstration in a real attempt with physics, renderer, expert and bundle."""

from __future__ import annotations

import hashlib
import io
from pathlib import Path

import pytest

from coordinator.validation.validate import validate
from schemas.bundle import BundleReader
from schemas.config import CameraConfig, DemonstrationConfig, TaskConfig
from schemas.instruction.templates import instruction
from schemas.job import Job
from schemas.scene import CompiledScene, encode_scene
from schemas.terms import ExpertName, FailReason, Recording, SuccessMeasure, Tier
from tests.builders.bundle import job_for
from tests.builders.scene import Box, build_scene, room_walls
from workers.experts.planner import STOPPED_M
from workers.sim.attempt import AttemptFailure, Outcome, Success, run_attempt
from workers.sim.context import SimulationContext

ROOM = room_walls((-4.0, -3.0), (4.0, 3.0))
RACK = Box((2.0, -1.3, 0.0), (2.8, 1.3, 2.0), (200, 30, 30), category="rack")
BOARD = Box((3.8, -0.3, 1.9), (4.0, 0.3, 2.4), (30, 30, 200), category="whiteboard", solid=False)
"""A target that is above the view of the camera when the robot is a metre away."""


def planner_job(scene: CompiledScene, **changes: object) -> Job:
    package, target = encode_scene(scene), scene.info.targets[0]
    values = {
        "scene_sha256": hashlib.sha256(package).hexdigest(),
        "scene_bytes": len(package),
        "category": target.category,
        "target_id": target.target_id,
        "colour": "unknown",
        "instruction": instruction("train_01", target.category, "unknown"),
        "tier": Tier.NEAR,
        "expert": ExpertName.PLANNER,
        "task": TaskConfig(success=SuccessMeasure.SURFACE),
        "demonstration": DemonstrationConfig(max_contact_steps=0, target_in_view=True),
    }
    return job_for(**values | changes)


def attempted(scene: CompiledScene, job: Job, folder: Path) -> tuple[Outcome, io.BytesIO]:
    out, path = io.BytesIO(), folder / "room.scene"
    path.write_bytes(encode_scene(scene))
    with SimulationContext("auto") as stage:
        stage.load(path, job.scene_sha256)
        return run_attempt(job, stage, out, "test", lambda _step: None), out


@pytest.mark.parametrize("attempt", [1, 2])
def test_a_demonstration_stops_in_front_of_a_rack_with_the_rack_in_view(tmp_path: Path, attempt: int) -> None:
    scene = build_scene((*ROOM, RACK))
    job = planner_job(scene, attempt=attempt)
    outcome, out = attempted(scene, job, tmp_path)
    assert isinstance(outcome, Success), outcome
    rollout = outcome.meta.rollout
    assert rollout.final_surface_m == pytest.approx(1.0 - STOPPED_M, abs=0.02)
    assert rollout.final_ne_m > 1.2
    assert (rollout.collision_count, rollout.target_in_view) == (0, True)
    with BundleReader(out) as bundle:
        assert validate(bundle, job, scene.info.targets[:1]) == []
        shown = bundle.ids(bundle.length - 1) == scene.info.targets[0].instance_id
        assert 0.1 < shown.mean() < 0.8


def test_a_path_that_ends_without_the_target_in_view_fails_before_the_drive(tmp_path: Path) -> None:
    scene = build_scene((*ROOM, BOARD))
    outcome, _ = attempted(scene, planner_job(scene), tmp_path)
    assert isinstance(outcome, AttemptFailure)
    assert (outcome.reason, outcome.steps) == (FailReason.NOT_IN_VIEW, 0)
    assert "without whiteboard_6 in view" in outcome.detail


def test_an_attempt_that_is_not_required_to_show_the_target_records_that_the_target_is_out_of_view(
    tmp_path: Path,
) -> None:
    scene = build_scene((*ROOM, BOARD))
    job = planner_job(scene, demonstration=DemonstrationConfig())
    outcome, out = attempted(scene, job, tmp_path)
    assert isinstance(outcome, Success), outcome
    assert outcome.meta.rollout.target_in_view is False
    with BundleReader(out) as bundle:
        assert validate(bundle, job, scene.info.targets[:1]) == []


@pytest.mark.parametrize("record", list(Recording))
def test_an_attempt_whose_first_frame_is_one_flat_surface_fails(tmp_path: Path, record: Recording) -> None:
    scene = build_scene((*ROOM, RACK))
    above = CameraConfig(z_m=9.5, far_m=1.0)  # no surface within the clip range
    job = planner_job(scene, camera=above, demonstration=DemonstrationConfig(), record=record)
    outcome, _ = attempted(scene, job, tmp_path)
    assert isinstance(outcome, AttemptFailure)
    assert (outcome.reason, outcome.steps > 0) == (FailReason.NO_VIEW, True)
    assert "one flat surface" in outcome.detail


def test_an_expert_that_never_saw_its_target_fails_for_this_reason(tmp_path: Path) -> None:
    scene = build_scene((*ROOM, RACK))
    job = planner_job(
        scene,
        camera=CameraConfig(z_m=9.5, far_m=1.0),
        demonstration=DemonstrationConfig(),
        expert=ExpertName.PROPORTIONAL,
        task=TaskConfig(max_steps=5),
    )
    outcome, _ = attempted(scene, job, tmp_path)
    assert isinstance(outcome, AttemptFailure)
    assert outcome.reason is FailReason.NO_VIEW
    assert "never in view" in outcome.detail
