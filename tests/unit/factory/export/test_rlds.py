"""RLDS steps of an episode and their TFDS dataset, without TensorFlow."""

from __future__ import annotations

import json
from collections import Counter

import numpy as np
import pytest

from factory.dataset.reader import Dataset
from factory.export.execution.export_run import ExportOrder, run_export
from factory.export.origin import find_origin
from factory.export.registry import find_exporter
from factory.export.rlds import DATASET_NAME, FOLDER, metadata_features, rlds_metadata, rlds_steps, step_features
from schemas.errors import UsageError
from tests.builders.dataset import make_dataset
from tests.builders.tfrecord import depth_of, examples_in, image_of, records_in


@pytest.fixture(scope="module")
def episode(tmp_path_factory):
    root = tmp_path_factory.mktemp("rlds") / "dataset"
    make_dataset(root, 1)
    return Dataset(root)[0]


def test_rlds_steps_mark_first_last_and_success(episode):
    steps = list(rlds_steps(episode))
    assert len(steps) == len(episode)
    assert [step["is_first"] for step in steps] == [True] + [False] * (len(steps) - 1)
    assert [step["is_last"] for step in steps] == [False] * (len(steps) - 1) + [True]
    assert sum(step["reward"] for step in steps) == 1.0 == steps[-1]["reward"]
    assert {step["language_instruction"] for step in steps} == {episode.instruction}
    assert all(step["is_terminal"] == step["is_last"] for step in steps)
    assert rlds_metadata(episode)["episode_id"] == "ep_000001"


def test_rlds_steps_at_full_size_are_the_frames(episode):
    for t, step in enumerate(rlds_steps(episode, image_px=640)):
        np.testing.assert_array_equal(step["observation"]["image"], episode.rgb(t))
        np.testing.assert_array_equal(step["observation"]["depth"][:, :, 0], episode.depth(t))
        np.testing.assert_array_equal(step["observation"]["ids"][:, :, 0], episode.ids(t))
        np.testing.assert_array_equal(step["action"], episode.actions[t])
        np.testing.assert_array_equal(step["action_tokens"], episode.tokens[t])


def test_rlds_steps_can_be_resized_and_subsampled(episode):
    steps = list(rlds_steps(episode, fps=20, image_px=64))
    assert len(steps) == 4
    for number, step in enumerate(steps):
        seen = step["observation"]
        assert (seen["image"].shape, seen["depth"].shape) == ((64, 64, 3), (64, 64, 1))
        assert np.isin(seen["depth"], episode.depth(3 * number)).all()
        np.testing.assert_allclose(step["action"], episode.actions[3 * number : 3 * number + 3].mean(axis=0), atol=1e-6)
        np.testing.assert_allclose(seen["state"][0], episode.poses[3 * number, 0], atol=1e-6)  # starts at the origin


def test_a_rate_that_does_not_divide_is_refused(episode):
    with pytest.raises(UsageError, match="60"):
        list(rlds_steps(episode, fps=25))


def exported(root, out, **values):
    options = find_exporter("rlds").options(fps=20, image_px=64, **values)
    assert run_export(ExportOrder(root, out, "rlds", options)).complete
    return out / FOLDER


@pytest.fixture(scope="module")
def out(varied, tmp_path_factory):
    return exported(varied, tmp_path_factory.mktemp("rlds") / "out")


def test_an_example_has_every_feature_with_the_values_of_the_steps(varied, out):
    data, seen = Dataset(varied), set()
    for file in out.glob("*.tfrecord-*"):
        for found in examples_in(file):
            episode = data[found["episode_metadata/episode_id"][0].decode()]
            seen.add(episode.episode_id)
            assert file.name.startswith(f"{DATASET_NAME}-{episode.summary.split}.tfrecord-")
            names = {f"steps/{name}" for name in step_features(64)}
            assert found.keys() == names | {f"episode_metadata/{name}" for name in metadata_features()}
            steps = list(rlds_steps(episode, 20, 64))
            for number, step in enumerate(steps):
                image, depth, ids = (found[f"steps/observation/{name}"][number] for name in ("image", "depth", "ids"))
                np.testing.assert_array_equal(image_of(image), step["observation"]["image"])
                np.testing.assert_array_equal(depth_of(depth), step["observation"]["depth"][:, :, 0])
                np.testing.assert_array_equal(image_of(ids), step["observation"]["ids"][:, :, 0])
            for name in ("action", "action_tokens", "camera_pose", "is_first", "is_last", "is_terminal", "reward"):
                np.testing.assert_array_equal(found[f"steps/{name}"], np.ravel([step[name] for step in steps]))
            assert found["steps/language_instruction"] == [episode.instruction.encode()] * len(steps)
            np.testing.assert_allclose(
                found["episode_metadata/camera_matrix"],
                np.ravel(rlds_metadata(episode, 64)["camera_matrix"]),
                rtol=1e-6,
            )
            assert found["episode_metadata/target_instance_id"] == [episode.meta.target_instance_id]
    assert seen == {episode.episode_id for episode in data}


def test_the_description_counts_the_episodes_of_every_split(varied, out):
    splits = {split["name"]: split for split in json.loads((out / "dataset_info.json").read_text())["splits"]}
    expected = Counter(str(episode.summary.split) for episode in Dataset(varied))
    assert {name: sum(map(int, split["shardLengths"])) for name, split in splits.items()} == expected
    for name, split in splits.items():
        files = sorted(out.glob(f"{DATASET_NAME}-{name}.tfrecord-*"))
        assert [str(sum(1 for _ in records_in(file, check=False))) for file in files] == split["shardLengths"]
        assert sum(file.stat().st_size for file in files) == int(split["numBytes"])


def test_splits_can_have_the_names_of_the_loaders(varied, tmp_path):
    out = exported(varied, tmp_path / "out", loader_splits=True)
    names = {split["name"] for split in json.loads((out / "dataset_info.json").read_text())["splits"]}
    assert "train" in names
    assert "train_id" not in names


def test_checksums_and_bytes_are_those_of_a_second_export(varied, out, tmp_path):
    again = exported(varied, tmp_path / "again")
    for file in sorted(out.iterdir()):
        assert (again / file.name).read_bytes() == file.read_bytes()
    small = min(out.glob("*.tfrecord-*"), key=lambda file: file.stat().st_size)
    assert len(list(records_in(small))) >= 1


def test_the_origin_of_an_episode_is_found(varied, out):
    for episode in Dataset(varied):
        assert find_origin(out.parents[1], episode.episode_id).states_digest == episode.states_digest
