"""The Gymnasium environment: contract, termination, and vectorised environments."""

from __future__ import annotations

import functools
import multiprocessing
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from factory.dataset.reader import Dataset
from factory.eval.models.spec import SpecSet
from factory.eval.specs.from_dataset import specs_of_dataset
from factory.export.lerobot.columns import frame_columns
from factory.gym.env import MiniVLANavEnv
from schemas.errors import UsageError
from schemas.rig import Rig, WheelOdometry
from schemas.support.geometry import STATE_NAMES
from schemas.terms import Split
from tests.builders.fresh_process import in_fresh_process
from tests.builders.rigs import small_rig

SMALL = 64


def make(drives: Dataset, **changes: Any) -> gymnasium.Env[Any, Any]:
    return gymnasium.make("factory.gym:MiniVLANav-v0", data=drives.root, size=SMALL, **changes)


@pytest.fixture(scope="module")
def specs(drives: Dataset) -> SpecSet:
    return specs_of_dataset(drives, [Split.TEST_ID])


@pytest.fixture
def env(drives: Dataset, specs: SpecSet) -> Iterator[MiniVLANavEnv]:
    opened = MiniVLANavEnv(drives.root, specs=specs, size=SMALL)
    yield opened
    opened.close()


@pytest.mark.parametrize(
    "changes",
    [
        {"actions": "scaled", "with_pose": True},
        {"actions": "tokens", "instruction": "none"},
        {"actions": "scaled", "instruction": "tokens"},
        {"actions": "scaled", "instruction": "none", "rig": small_rig()},
    ],
)
def test_gymnasiums_checker_reports_no_warning(drives: Dataset, specs: SpecSet, changes: dict[str, Any]) -> None:
    opened = make(drives, specs=specs, render_mode="rgb_array", **changes)
    try:
        check_env(opened.unwrapped, skip_render_check=True)
        opened.reset(seed=1)
        assert np.asarray(opened.render()).shape == (640, 640, 3)
    finally:
        opened.close()


def test_the_only_warning_of_the_checker_on_physical_ranges_recommends_scaled_actions(
    drives: Dataset, specs: SpecSet
) -> None:
    opened = make(drives, specs=specs)
    with pytest.warns(UserWarning, match="symmetric and normalized") as said:
        check_env(opened.unwrapped, skip_render_check=True)
    opened.close()
    assert len(said) == 1


def test_scaled_actions_are_fractions_of_the_limits(drives: Dataset, specs: SpecSet) -> None:
    tracks = []
    for actions, action in (("continuous", [0.5, 0.75]), ("scaled", [0.5, 0.5])):
        opened = MiniVLANavEnv(drives.root, specs=specs, actions=actions, with_pose=True, size=SMALL)  # type: ignore[arg-type]
        opened.reset(seed=0)
        tracks.append([opened.step(np.array(action))[0]["pose"].tolist() for _ in range(10)])
        opened.close()
    assert tracks[0] == tracks[1]


def test_recorded_actions_end_in_success_with_a_complete_info(drives: Dataset, env: MiniVLANavEnv) -> None:
    _, info = env.reset(options={"episode": "ep_000003"})
    rewards = 0.0
    for action in drives["ep_000003"].actions:
        _, reward, terminated, truncated, info = env.step(action)
        rewards += reward
    assert (terminated, truncated) == (True, False)
    archived = drives["ep_000003"].summary
    assert (info["success"], info["end_reason"], info["episode_id"]) == (True, "success", "ep_000003")
    assert info["distance_m"] == pytest.approx(archived.final_ne_m, abs=1e-5)
    assert info["trajectory_length_m"] == pytest.approx(archived.trajectory_length_m, abs=1e-4)
    assert rewards == pytest.approx(archived.spawn_dist_m - archived.final_ne_m + 10.0, abs=1e-3)
    assert 0.9 < info["spl"] <= 1.0


def test_the_step_limit_truncates_an_episode(drives: Dataset, specs: SpecSet) -> None:
    task = specs.settings.task.model_copy(update={"max_steps": 3})
    short = specs.model_copy(update={"settings": specs.settings.model_copy(update={"task": task})})
    opened = MiniVLANavEnv(drives.root, specs=short, actions="tokens", size=SMALL)
    opened.reset(seed=0)
    ends = [opened.step(np.array([0, 3]))[2:4] for _ in range(3)]
    opened.close()
    assert ends == [(False, False), (False, False), (False, True)]


def test_the_episode_is_chosen_by_seed_or_by_name(env: MiniVLANavEnv) -> None:
    drawn = [env.reset(seed=seed)[1]["episode_id"] for seed in (1, 1, 2, 3, 4, 5)]
    assert drawn[0] == drawn[1]
    assert set(drawn) == {"ep_000002", "ep_000003"}
    with pytest.raises(UsageError, match="episode 'ep_000001' is not one of the 2 selected episodes"):
        env.reset(options={"episode": "ep_000001"})


def test_the_pose_begins_at_the_origin_and_moves_forward(drives: Dataset, specs: SpecSet) -> None:
    opened = MiniVLANavEnv(drives.root, specs=specs, with_pose=True, size=SMALL)
    observation, _ = opened.reset(seed=0)
    np.testing.assert_allclose(observation["pose"], 0.0, atol=1e-9)
    for _ in range(20):
        observation, *_ = opened.step(np.array([1.0, 0.0], np.float32))
    opened.close()
    assert observation["pose"][0] > 0.05
    assert abs(observation["pose"][1]) < 0.02


@pytest.mark.parametrize("action", [np.array([np.nan, 0.0]), np.zeros(3), np.array(0.0)])
def test_an_invalid_action_is_refused(env: MiniVLANavEnv, action: np.ndarray) -> None:
    env.reset(seed=0)
    with pytest.raises(ValueError, match="two finite numbers"):
        env.step(action)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"size": 0}, "choose 1 to 2048 pixels"),
        ({"size": 4096}, "choose 1 to 2048 pixels"),
        ({"actions": "joints"}, "tokens"),
        ({"split": "test"}, "unknown split test"),
        ({"instruction": "words"}, "valid values: text, tokens, none"),
        ({"vocabulary": ("<pad>", "<unknown>", "<any>", "go")}, "requires instruction='tokens'"),
        ({"instruction": "tokens", "vocabulary": ("go", "to")}, "not a valid vocabulary"),
    ],
)
def test_wrong_settings_are_named(drives: Dataset, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        MiniVLANavEnv(drives.root, **changes)


def test_without_data_the_error_names_the_argument() -> None:
    with pytest.raises(UsageError, match=r"data is missing: pass .* gymnasium\.make\(ID, data="):
        gymnasium.make("factory.gym:MiniVLANav-v0")


def test_frames_of_any_size_show_the_camera_view_and_do_not_change_the_episode(drives: Dataset, specs: SpecSet) -> None:
    actions = drives["ep_000002"].actions[:15]
    seen: dict[int, tuple[Any, list[float]]] = {}
    for size in (640, 100):
        opened = MiniVLANavEnv(drives.root, specs=specs, size=size, render_mode="rgb_array")
        observation, info = opened.reset(options={"episode": "ep_000002"})
        assert opened.observation_space.contains(observation)
        track = [info["distance_m"], *(opened.step(action)[4]["distance_m"] for action in actions)]
        assert np.asarray(opened.render()).shape == (640, 640, 3)
        opened.close()
        seen[size] = observation, track
    (whole, at_640), (small, at_100) = seen[640], seen[100]
    assert at_640 == at_100
    np.testing.assert_array_equal(whole["rgb"], drives["ep_000002"].frame(0).rgb)
    nearest = ((np.arange(100) + 0.5) * 6.4).astype(int)
    shrunk = whole["depth"][np.ix_(nearest, nearest)]
    assert np.median(np.abs(small["depth"] - shrunk)) < 0.02


def test_tokens_are_word_ids_and_equal_in_all_splits(drives: Dataset) -> None:
    found = []
    for split in ("train_id", "test_id"):
        opened = MiniVLANavEnv(drives.root, split=split, size=SMALL, instruction="tokens")
        observation, info = opened.reset(seed=0)
        numbers, words = observation["instruction"], opened.vocabulary
        assert (numbers.dtype, numbers.shape) == (np.int64, (16,))
        assert opened.observation_space.contains(observation)
        read = [words[number] for number in numbers if number]
        assert read == info["instruction"].lower().rstrip(".").split()
        assert not numbers[len(read) :].any()
        found.append(words)
        opened.close()
    assert found[0] == found[1]
    assert found[0][:2] == ("<pad>", "<unknown>")
    assert {"crate", "red", "halt"} <= set(found[0])


def test_a_training_vocabulary_is_kept_and_other_words_are_unknown(drives: Dataset) -> None:
    words = ("<pad>", "<unknown>", "<any>", "go", "to")
    opened = MiniVLANavEnv(drives.root, size=SMALL, instruction="tokens", vocabulary=words)
    observation, info = opened.reset(seed=0)
    opened.close()
    assert info["instruction"].startswith("Go to the ")
    assert observation["instruction"].tolist()[:5] == [3, 4, 1, 1, 0]
    assert opened.observation_space.contains(observation)


def test_the_instruction_is_only_in_the_info_when_excluded_from_observations(drives: Dataset) -> None:
    opened = MiniVLANavEnv(drives.root, size=SMALL, instruction="none")
    observation, info = opened.reset(seed=0)
    opened.close()
    assert set(observation) == {"rgb", "depth", "state"}
    assert info["instruction"].startswith("Go to the ")


def drive_two_episodes(drives: Dataset, specs: SpecSet, context: str | None, instruction: str) -> None:
    vector = gymnasium.make_vec(
        "factory.gym:MiniVLANav-v0",
        num_envs=2,
        vectorization_mode="async",
        vector_kwargs={} if context is None else {"context": context},
        data=drives.root,
        specs=specs,
        size=SMALL,
        instruction=instruction,
    )
    try:
        for episode in ("ep_000002", "ep_000003"):  # their targets are the barrel and the crate
            first, info = vector.reset(options={"episode": episode})
            assert first["rgb"].shape == (2, SMALL, SMALL, 3)
            if instruction == "text":
                assert first["instruction"] == tuple(info["instruction"])
            elif instruction == "tokens":
                assert first["instruction"].shape == (2, 16)
        after, *_ = vector.step(np.array([[1.0, 0.0]] * 2, np.float32))
        assert after["depth"].any()
        if instruction == "text":
            assert after["instruction"] == tuple(info["instruction"])
    finally:
        vector.close(terminate=True)


@pytest.mark.timeout(240)
@pytest.mark.parametrize("context", ["forkserver", "spawn"])
@pytest.mark.parametrize("instruction", ["text", "tokens", "none"])
def test_make_vec_works_with_processes_that_are_not_forked(
    drives: Dataset, specs: SpecSet, context: str, instruction: str
) -> None:
    drive_two_episodes(drives, specs, context, instruction)


@pytest.mark.timeout(240)
@pytest.mark.parametrize("instruction", ["text", "tokens", "none"])
def test_make_vec_works_with_forked_processes(drives: Dataset, specs: SpecSet, instruction: str) -> None:
    """By default, Gymnasium first creates an environment to read its spaces, and then forks the process."""
    in_fresh_process(drive_two_episodes, drives, specs, None, instruction)


def compare_texts(drives: Dataset, specs: SpecSet) -> None:
    makers = [functools.partial(open_one, drives.root, specs)]
    vector = gymnasium.vector.AsyncVectorEnv(makers, copy=False)
    try:
        for episode in ("ep_000002", "ep_000003"):
            observation, info = vector.reset(options={"episode": episode})
            assert list(observation["instruction"]) == list(info["instruction"])
    finally:
        vector.close(terminate=True)


@pytest.mark.timeout(240)
def test_instructions_are_current_when_observations_are_not_copied_from_shared_memory(
    drives: Dataset, specs: SpecSet
) -> None:
    in_fresh_process(compare_texts, drives, specs)


@pytest.mark.timeout(120)
def test_the_error_of_an_environment_used_after_a_fork_names_the_alternatives(env: MiniVLANavEnv) -> None:
    env.reset(seed=0)
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe(duplex=False)

    def use() -> None:
        for act in (lambda: env.reset(seed=0), lambda: env.step(np.zeros(2))):
            try:
                act()
            except UsageError as error:
                theirs.send(str(error))

    process = context.Process(target=use)
    process.start()
    said = [ours.recv() if ours.poll(60) else "hangs" for _ in range(2)]
    process.join(30)
    assert ["make_vec(ID, num_envs=4, vectorization_mode='async'" in each for each in said] == [True, True]
    env.step(np.zeros(2))  # the environment in the parent still works


@pytest.mark.gl
def test_the_process_of_an_environment_never_loads_a_graphics_driver(drives: Dataset) -> None:
    """Without a graphics driver, the process can load any library that contains LLVM or another OpenGL."""
    program = f"""
import gymnasium, numpy
env = gymnasium.make("factory.gym:MiniVLANav-v0", data={str(drives.root)!r}, size=64, renderer="gl")
env.reset(seed=0)
env.step(numpy.zeros(2, numpy.float32))
mapped = open("/proc/self/maps").read()
print([name for name in ("libEGL", "libLLVM", "_dri.so", "libgallium") if name in mapped])
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["[]"]


def open_one(root: Any, specs: SpecSet) -> gymnasium.Env[Any, Any]:
    return MiniVLANavEnv(root, specs=specs, size=SMALL)


def test_environments_run_side_by_side_in_spawned_processes(drives: Dataset, specs: SpecSet) -> None:
    makers = [functools.partial(open_one, drives.root, specs)] * 2
    vector = gymnasium.vector.AsyncVectorEnv(makers, context="spawn", shared_memory=False)
    try:
        first, info = vector.reset(seed=[1, 2])
        assert first["rgb"].shape == (2, SMALL, SMALL, 3)
        assert [words.startswith("Go to the") for words in first["instruction"]] == [True, True]
        for _ in range(3):
            after, rewards, terminated, truncated, info = vector.step(np.array([[1.0, 0.0]] * 2, np.float32))
        assert rewards.shape == (2,)
        assert not terminated.any()
        assert not truncated.any()
        assert info["distance_m"].shape == (2,)
        assert (after["rgb"] != first["rgb"]).any()
    finally:
        vector.close()


def test_split_all_has_the_episodes_of_every_split(drives: Dataset) -> None:
    opened = MiniVLANavEnv(drives.root, split="all", size=SMALL)
    try:
        assert {spec.spec_id for spec in opened.specs.specs} == set(drives.column("episode_id").to_pylist())
    finally:
        opened.close()


def test_the_state_equals_that_of_the_export_of_the_same_drive(drives: Dataset) -> None:
    episode = drives.filter(split="test_id")[0]
    exported = frame_columns(episode.actions, episode.poses, episode.meta.job.task.control_hz, 1).state
    opened = MiniVLANavEnv(drives.root, split="test_id", size=8)
    try:
        states = [opened.reset(options={"episode": episode.episode_id})[0]["state"]]
        states += [opened.step(np.array(action))[0]["state"] for action in episode.actions[:-1]]
    finally:
        opened.close()
    np.testing.assert_array_equal(states, exported)
    assert exported[-1][0] > 0.3
    assert STATE_NAMES == ("x_m", "y_m", "yaw_rad", "v_mps", "w_rps")


def test_the_state_of_a_rig_is_that_of_its_wheel_odometry(drives: Dataset, specs: SpecSet) -> None:
    wheels = WheelOdometry(name="wheels", model="odometry")
    opened = make(drives, specs=specs, rig=Rig(name="wheels", sensors=(wheels,)))
    try:
        opened.reset(seed=0)
        for _ in range(7):
            seen = opened.step(np.array((0.5, 0.2)))[0]
    finally:
        opened.close()
    expected = np.concatenate((seen["wheels/poses"], seen["wheels/twists"])).astype(np.float32)
    np.testing.assert_array_equal(seen["state"], expected)
    assert seen["state"][3] > 0.1


def test_without_state_the_space_is_that_of_version_0_2(drives: Dataset, specs: SpecSet) -> None:
    opened = make(drives, specs=specs, with_state=False)
    assert set(opened.observation_space.spaces) == {"rgb", "depth", "instruction"}
    opened.close()
