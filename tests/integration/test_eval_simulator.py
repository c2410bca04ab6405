"""The stepping simulator reproduces archived drives bit for bit and checks its arguments."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from factory.dataset.reader import Dataset
from factory.eval.driving.simulator import Simulator
from factory.eval.models.spec import SpecSet
from factory.eval.specs.from_dataset import LoadedScenes, specs_of_dataset
from schemas.errors import UsageError, WorldError
from schemas.terms import EndReason, Split
from workers.experts import make_expert
from workers.geometry.slew import Twist
from workers.sim.context import LoadedScene, SimulationContext


@pytest.fixture(scope="module")
def specs(drives: Dataset) -> SpecSet:
    return specs_of_dataset(drives, [Split.TRAIN_ID, Split.TEST_ID])


@pytest.fixture(scope="module")
def stage() -> Iterator[SimulationContext]:
    with SimulationContext("auto") as opened:
        yield opened


@pytest.fixture(scope="module")
def place(drives: Dataset, specs: SpecSet) -> LoadedScene:
    return LoadedScenes(drives.root).load("office", specs.specs[0].scene_sha256)


def test_recorded_actions_reproduce_the_recorded_poses_to_the_last_bit(
    drives: Dataset, specs: SpecSet, stage: SimulationContext, place: LoadedScene
) -> None:
    for spec in specs.specs:
        episode = drives[spec.spec_id]
        with Simulator(stage, specs.settings) as simulator:
            view = simulator.reset(spec, place)
            for v, w in episode.actions:
                assert view.end is None
                view = simulator.step(Twist(float(v), float(w)))
            assert view.end is EndReason.SUCCESS
            np.testing.assert_array_equal(simulator.arrays().poses, episode.poses)
            np.testing.assert_array_equal(simulator.arrays().actions_continuous, episode.actions)
            np.testing.assert_array_equal(view.frame.rgb, episode.rgb(-1))


def test_an_expert_in_the_closed_loop_reproduces_its_archived_drive(
    drives: Dataset, specs: SpecSet, stage: SimulationContext, place: LoadedScene
) -> None:
    spec = specs.specs[1]
    with Simulator(stage, specs.settings) as simulator:
        view = simulator.reset(spec, place)
        expert = make_expert(spec.job(specs.settings))
        assert expert.begin(view.pose, place.grid, simulator.target) is not None
        while view.end is None:
            view = simulator.step(expert.act(simulator.observe()))
        np.testing.assert_array_equal(simulator.arrays().poses, drives[spec.spec_id].poses)


def test_specs_contain_the_drawn_start_and_the_visible_objects(drives: Dataset, specs: SpecSet) -> None:
    for spec in specs.specs:
        meta = drives[spec.spec_id].meta
        assert spec.spawn_source == "job"
        assert spec.spawn_pose == pytest.approx(meta.rollout.spawn_pose, abs=5e-3)
        assert spec.is_target_in_view
        assert spec.category in spec.categories_in_view
        assert set(spec.categories_in_view) <= {"crate", "barrel"}


def test_an_episode_of_another_version_starts_at_its_first_recorded_pose(
    drives: Dataset, specs: SpecSet, stage: SimulationContext, place: LoadedScene
) -> None:
    x, y, yaw = drives["ep_000001"].meta.rollout.spawn_pose
    spec = specs.specs[0].model_copy(update={"spawn_pose": (x, y, yaw), "spawn_source": "frame"})
    with Simulator(stage, specs.settings) as simulator:
        pose = simulator.reset(spec, place).pose
        assert (pose.x, pose.y) == pytest.approx((x, y), abs=2e-3)


def test_speeds_out_of_range_are_clipped_and_slew_limited(
    specs: SpecSet, stage: SimulationContext, place: LoadedScene
) -> None:
    with Simulator(stage, specs.settings) as simulator:
        simulator.reset(specs.specs[0], place)
        simulator.step(Twist(-3.0, 9.0))
        assert simulator.command.v_mps == 0.0
        assert simulator.command.w_rps == pytest.approx(3.2 / specs.settings.task.control_hz)
        for _ in range(40):
            simulator.step(Twist(0.0, 9.0))
        assert simulator.command.w_rps == 1.5


def test_an_episode_without_motion_ends_at_the_step_limit(
    specs: SpecSet, stage: SimulationContext, place: LoadedScene
) -> None:
    settings = specs.settings.model_copy(update={"task": specs.settings.task.model_copy(update={"max_steps": 7})})
    with Simulator(stage, settings) as simulator:
        view = simulator.reset(specs.specs[0], place)
        while view.end is None:
            view = simulator.step(Twist(0.0, 0.0))
        assert view.end is EndReason.TIMEOUT
        assert simulator.steps == 7
        with pytest.raises(RuntimeError, match="reset"):
            simulator.step(Twist(0.0, 0.0))


def test_a_start_inside_a_wall_is_refused_with_the_episode_name(
    specs: SpecSet, stage: SimulationContext, place: LoadedScene
) -> None:
    spec = specs.specs[0].model_copy(update={"spawn_pose": (-3.95, 0.0, 0.0)})
    with (
        Simulator(stage, specs.settings) as simulator,
        pytest.raises(WorldError, match=r"ep_000001.*robot is not stable at its start in office"),
    ):
        simulator.reset(spec, place)


def test_a_split_without_episodes_is_named(drives: Dataset) -> None:
    with pytest.raises(UsageError, match=r"no episodes in val_id; splits with episodes: test_id, train_id"):
        specs_of_dataset(drives, [Split.TEST_ID, Split.VAL_ID])


def test_frames_are_rendered_on_demand_and_never_after_the_end_of_an_episode(
    specs: SpecSet, place: LoadedScene
) -> None:
    stages: list[str] = []
    with SimulationContext("auto", stages.append) as stage, Simulator(stage, specs.settings) as simulator:
        view = first = simulator.reset(specs.specs[0], place)
        for _ in range(5):
            view = simulator.step(Twist(0.5, 0.0))
        assert "read-back" not in stages
        drawn = view.frame
        assert stages.count("read-back") == 1
        assert view.frame is drawn
        assert simulator.step(Twist(0.5, 0.0)).frame.rgb.shape == (640, 640, 3)
        assert stages.count("read-back") == 2
        simulator.reset(specs.specs[1], place)
        with pytest.raises(RuntimeError, match="keep the frame"):
            _ = first.frame
