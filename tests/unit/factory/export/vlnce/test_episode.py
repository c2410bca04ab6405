"""Episodes in Habitat's conventions: axes, headings, paths, tokens."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from factory.export.vlnce.episode import (
    EpisodeText,
    from_habitat,
    rotation_of,
    thin_track,
    to_habitat,
    tokens_of_text,
    vlnce_episode,
    vocabulary_of,
    words_of,
)
from schemas.dataset.origin import EpisodeOrigin
from schemas.support.geometry import footprint_distances
from schemas.terms import SuccessMeasure
from tests.builders.bundle import GOAL_M, RADIUS_M, parts_for, short_task

SAID = EpisodeText("Go to the chair.", "train_01")
ORIGIN = EpisodeOrigin(episode="ep_000001", version="unknown", states_digest="0" * 32, job=parts_for().sealed().job)

COORDINATES = st.floats(-1e3, 1e3, allow_nan=False).map(lambda value: value + 0.0)


@given(st.tuples(COORDINATES, COORDINATES, COORDINATES))
def test_points_are_converted_to_habitat_and_back(point):
    assert from_habitat(to_habitat(point)) == point


def test_the_up_axis_is_converted_and_axes_stay_right_handed():
    x, y, z = (np.array(to_habitat(axis)) for axis in np.eye(3).tolist())
    np.testing.assert_array_equal(z, (0, 1, 0))
    np.testing.assert_array_equal(np.cross(x, y), z)


@pytest.mark.parametrize("yaw", [0.0, 0.3, math.pi / 2, math.pi, -2.0])
def test_the_agent_has_the_heading_of_the_robot(yaw):
    forward = Rotation.from_quat(rotation_of(yaw)).apply((0, 0, -1))
    np.testing.assert_allclose(forward, to_habitat((math.cos(yaw), math.sin(yaw), 0.0)), atol=1e-12)


def test_an_agent_stands_upright():
    np.testing.assert_allclose(Rotation.from_quat(rotation_of(1.1)).apply((0, 1, 0)), (0, 1, 0), atol=1e-12)


@given(st.floats(0.02, 12.0), st.integers(2, 400))
def test_a_subsampled_trajectory_keeps_its_ends_and_spacing(length_m, steps):
    track = np.zeros((steps, 3))
    track[:, 0] = np.linspace(0, length_m, steps)
    thin = thin_track(track)
    np.testing.assert_array_equal(thin[[0, -1]], track[[0, -1]])
    gaps = np.diff(thin[:, 0])
    step = length_m / (steps - 1)
    assert (gaps > 0).all()
    assert gaps.max() <= max(0.25 * 1.5 + step, step + 1e-9)


def test_a_stationary_robot_has_a_path_of_one_point():
    assert len(thin_track(np.ones((7, 3)))) <= 2


def test_words_are_encoded_and_decoded():
    texts = ["Go to the red sofa.", "Drive to the chair, then stop."]
    words = vocabulary_of(texts)
    assert words[:2] == ["<pad>", "<unk>"]
    index = {word: number for number, word in enumerate(words)}
    tokens = tokens_of_text(texts[1], index, 12)
    assert len(tokens) == 12
    assert [words[token] for token in tokens if token] == words_of(texts[1])
    assert tokens_of_text("Go to the zebra.", index, 5)[3] == 1


def test_an_entry_has_the_fields_that_habitat_requires():
    parts = parts_for()
    entry = json.loads(json.dumps(vlnce_episode(parts.sealed(), parts.arrays.poses, 0.0, SAID, ORIGIN)))
    assert entry["goals"] == [{"position": [GOAL_M[0], 0.0, 0.0], "radius": RADIUS_M}]
    assert entry["start_position"] == [0.0, 0.0, 0.0]
    assert entry["scene_id"] == "minivla/office/office.glb"
    assert entry["instruction"]["instruction_text"] == SAID.instruction
    assert EpisodeOrigin.model_validate(entry["info"]["origin"]) == ORIGIN
    assert {"episode_id", "trajectory_id", "start_rotation", "reference_path", "info"} <= entry.keys()
    end = [float(value) for value in parts.arrays.poses[-1, :3]]
    assert from_habitat(entry["reference_path"][-1]) == pytest.approx(end)


def test_goals_by_surface_are_points_of_the_footprint_with_the_nearest_first():
    square = ((1.0, -0.5), (2.0, -0.5), (2.0, 0.5), (1.0, 0.5))
    task = short_task().model_copy(update={"success": SuccessMeasure.SURFACE})
    parts = parts_for().with_meta(target_footprint_m=square).with_job(task=task)
    goals = vlnce_episode(parts.sealed(), parts.arrays.poses, 0.0, SAID, ORIGIN)["goals"]
    points = np.array([from_habitat(goal["position"])[:2] for goal in goals])
    assert len(points) == 16
    assert points[0].tolist() == [1.0, 0.0]
    assert np.linalg.norm(np.diff(np.unique(points, axis=0)[:5], axis=0), axis=1).max() <= 0.25
    seen_from = np.array([0.0, 0.3])
    nearest = np.linalg.norm(points - seen_from, axis=1).min()
    assert nearest == pytest.approx(float(footprint_distances(seen_from, square)), abs=0.02)
