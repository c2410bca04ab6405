"""Recordings of frames and of states have equal drives, equal metadata and equal frame digests."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Iterator

import numpy as np
import pytest

from coordinator.validation.validate import validate
from schemas.bundle import BundleReader
from schemas.config import RobotConfig, TaskConfig
from schemas.instruction.templates import instruction
from schemas.job import Job
from schemas.scene import encode_scene
from schemas.support.stage_timer import StageTimer
from schemas.terms import ExpertName, Recording
from tests.builders.bundle import job_for
from tests.builders.scene import box_room
from workers.sim.attempt import Success, run_attempt
from workers.sim.context import SimulationContext

pytestmark = pytest.mark.gl
PACKAGE = encode_scene(box_room())
SHA256 = hashlib.sha256(PACKAGE).hexdigest()
TARGET = box_room().info.targets[0]
SLOW_ROBOT = RobotConfig(physics_substeps=16, max_braking_mps2=4.0)
"""Robot for 15 control steps per second; the physics step has its usual length."""


class Renderings:
    """Counts the rendered images."""

    def __init__(self) -> None:
        self.count = 0

    def __call__(self, stage: str) -> None:
        self.count += stage == "render"


@pytest.fixture(scope="module")
def renderings() -> Renderings:
    return Renderings()


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory, renderings: StageTimer) -> Iterator[SimulationContext]:
    path = tmp_path_factory.mktemp("room") / "room.scene"
    path.write_bytes(PACKAGE)
    with SimulationContext("gl", renderings) as found:
        found.load(path, SHA256)
        yield found


def job_in_room(record: Recording, index: int, expert: ExpertName) -> Job:
    values = {
        "scene": "box_room",
        "scene_sha256": SHA256,
        "category": TARGET.category,
        "target_id": TARGET.target_id,
        "instruction": instruction("train_01", TARGET.category, "red"),
    }
    # 15 Hz for fewer frames; only the first drive has the rate of the paper
    rate = {"task": TaskConfig()} if index == 1 else {"task": TaskConfig(control_hz=15), "robot": SLOW_ROBOT}
    return job_for(index, record=record, expert=expert, **values, **rate)


def recorded(stage: SimulationContext, job: Job) -> BundleReader:
    file = io.BytesIO()
    outcome = run_attempt(job, stage, file, "host-1", lambda _step: None)
    assert isinstance(outcome, Success), outcome
    bundle = BundleReader(file)
    assert validate(bundle, job, (TARGET,)) == []
    return bundle


@pytest.mark.parametrize("expert", [ExpertName.PROPORTIONAL, ExpertName.DEPTH, ExpertName.PLANNER])
def test_both_recordings_have_the_same_drive_and_equal_frame_digests(
    stage: SimulationContext, expert: ExpertName
) -> None:
    for index in (1, 2, 3):
        frames, states = (recorded(stage, job_in_room(record, index, expert)) for record in Recording)
        assert (frames.has_frames, states.has_frames) == (True, False)
        for one, other in zip(frames.arrays.in_order(), states.arrays.in_order(), strict=True):
            assert np.array_equal(one, other)
        expected = frames.meta.rollout
        if not expert.uses_images:
            expected = expected.model_copy(update={"steps_visible": None})
        assert states.meta.rollout == expected
        assert states.meta.route == frames.meta.route
        steps = states.meta.job.sampled_steps(states.length)
        assert {0, states.length - 1} <= set(steps)
        assert states.meta.frame_digests == tuple(frames.meta.frame_digests[t] for t in steps)


def test_planner_renders_only_sampled_frames_and_the_last_one(stage: SimulationContext, renderings: Renderings) -> None:
    before = renderings.count
    states = recorded(stage, job_in_room(Recording.STATES, 4, ExpertName.PLANNER))
    assert renderings.count - before <= len(states.meta.frame_digests) + 1 <= 4


def test_a_states_recording_is_a_few_kilobytes_per_hundred_steps(stage: SimulationContext) -> None:
    states = recorded(stage, job_in_room(Recording.STATES, 5, ExpertName.PROPORTIONAL))
    assert sum(states.member_bytes().values()) < 6_000 + 80 * states.length
