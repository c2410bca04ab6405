"""Episodes whose target is drawn at the start. The start does not depend on the target; validation repeats the draw."""

from __future__ import annotations

import hashlib
import io
from pathlib import Path

import pytest

from coordinator.validation.instruction_check import said_findings
from coordinator.validation.validate import validate
from schemas.bundle import BundleReader
from schemas.config import RobotConfig, SpawnConfig, TaskConfig
from schemas.instruction.start_view import StartView, TargetChoice
from schemas.instruction.templates import FROM_START, instruction
from schemas.job import Job
from schemas.language.language_file import LanguageSpec
from schemas.scene import encode_scene
from schemas.terms import ExpertName, SuccessMeasure, Tier
from tests.builders.attempts import first_success, loaded_renderer, write_package
from tests.builders.bundle import job_for
from tests.builders.scene import Box, build_scene, room_walls
from workers.sim.attempt import Success, run_attempt
from workers.sim.context import SimulationContext


def _crate(x: float, y: float) -> Box:
    return Box((x - 0.3, y - 0.3, 0.0), (x + 0.3, y + 0.3, 0.6), (200, 30, 30), category="crate")


SCENE = build_scene((*room_walls((-5.0, -5.0), (5.0, 5.0)), _crate(1.5, 1.7), _crate(1.5, -1.7), _crate(-4.0, 4.0)))
AMONG = tuple(target.instance_id for target in SCENE.info.targets)
PACKAGE = encode_scene(SCENE, level=1)


def _job(attempt: int, share: float) -> Job:
    target = SCENE.info.targets[0]
    return job_for(
        attempt=attempt,
        scene=SCENE.info.name,
        scene_sha256=hashlib.sha256(PACKAGE).hexdigest(),
        tier=Tier.NEAR,
        category="crate",
        colour=target.colour,
        template_id=FROM_START,
        instruction=instruction(FROM_START, "crate", "unknown"),
        target_id=target.target_id,
        expert=ExpertName.PLANNER,
        task=TaskConfig(control_hz=15, success_radius_m=1.2, hold_steps=2, success=SuccessMeasure.SURFACE),
        robot=RobotConfig(physics_substeps=16, max_braking_mps2=4.0),
        spawn=SpawnConfig(heading_noise_rad=0.75),
        language=LanguageSpec(in_view=1, exchangeable=True),
        start_view=StartView(
            least_same_category=1, choice=TargetChoice(around=target.instance_id, among=AMONG, share=share)
        ),
    )


@pytest.fixture(scope="module")
def package(tmp_path_factory) -> Path:
    return write_package(tmp_path_factory.mktemp("scene"), PACKAGE)


@pytest.fixture(scope="module")
def stage(package):
    with loaded_renderer(package) as renderer:
        yield renderer


def _episode(stage: SimulationContext, share: float) -> tuple[Job, BundleReader]:
    """Returns the first successful attempt and its leased job."""
    return first_success((_job(attempt, share) for attempt in range(1, 12)), stage)


def test_two_jobs_with_the_same_start_view_have_different_targets(stage, package):
    (low_job, low), (high_job, high) = _episode(stage, 0.1), _episode(stage, 0.9)
    with low, high:
        assert low.meta.rollout.spawn_pose == high.meta.rollout.spawn_pose
        assert (low.ids(0) == high.ids(0)).all()
        assert low.meta.choices == high.meta.choices == AMONG[:2]
        assert (low.meta.target_instance_id, high.meta.target_instance_id) == AMONG[:2]
        for job, bundle in ((low_job, low), (high_job, high)):
            assert validate(bundle, job, SCENE.info.targets) == []
            assert said_findings(bundle, package) == []
            assert bundle.meta.language is not None
            assert bundle.meta.language.fits == 1


def test_the_recorded_job_gives_the_same_episode_again(stage):
    _, bundle = _episode(stage, 0.9)
    with bundle:
        again = io.BytesIO()
        assert isinstance(run_attempt(bundle.meta.job, stage, again, "replay", lambda _: None), Success)
        with BundleReader(again) as other:
            assert other.meta.content_digest == bundle.meta.content_digest


def test_an_episode_with_another_target_or_with_other_candidates_is_refused(stage):
    job, bundle = _episode(stage, 0.9)
    with bundle:
        meta, first = bundle.meta, SCENE.info.targets[0]
        moved = meta.model_copy(
            update={
                "job": meta.job.aimed_at(first),
                "target_instance_id": first.instance_id,
                "target_prim_path": first.prim_path,
                "target_centroid_m": first.centroid_m,
                "target_footprint_m": first.footprint_m,
            }
        )
        cases = {
            f"the target is object {AMONG[0]}, the job selects {AMONG[1]}": moved,
            "1 objects could be the target, the plan requires at least 2": meta.model_copy(
                update={"choices": AMONG[1:2]}
            ),
            f"objects {list(AMONG[:2])} could be the target in the first frame": meta.model_copy(
                update={"choices": AMONG}
            ),
            "job.start_view: the bundle has": meta.model_copy(update={"job": _job(meta.job.attempt, 0.1)}),
            "colour is 'pink', but the scene has": meta.model_copy(
                update={"job": meta.job.model_copy(update={"colour": "pink"})}
            ),
        }
        for finding, wrong in cases.items():
            bundle.meta = wrong
            assert finding in "\n".join(validate(bundle, job, SCENE.info.targets))
        bundle.meta = meta.model_copy(update={"choices": (*AMONG[:2], 99)})
        assert "the job permits" in "\n".join(validate(bundle, job)), "wrong candidates are accepted without the scene"


def test_recorded_candidates_are_refused_if_the_plan_names_the_target(stage):
    job, bundle = _episode(stage, 0.1)
    with bundle:
        plain = job.model_copy(update={"start_view": None})
        bundle.meta = bundle.meta.model_copy(update={"job": plain})
        assert "but the plan of the job names the target" in "\n".join(validate(bundle, plain))
