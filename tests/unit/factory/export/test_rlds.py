"""RLDS steps of an episode, without TensorFlow."""

from __future__ import annotations

import numpy as np
import pytest

from factory.dataset.reader import Dataset
from factory.export.rlds import rlds_metadata, rlds_steps
from schemas.errors import UsageError
from tests.builders.dataset import make_dataset


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
