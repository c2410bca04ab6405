"""Violations of array specs."""

from __future__ import annotations

import numpy as np
import pytest

from schemas.encoding.arrays import ACTIONS_CONTINUOUS, ACTIONS_TOKENS, DEPTH_FRAME, EXPERT_ACTIONS, POSES, ArraySpec

GOOD = np.zeros((3, 2), np.float32)


def test_fitting_array_has_no_violations() -> None:
    assert ACTIONS_CONTINUOUS.violations(GOOD, 3) == []
    assert ACTIONS_CONTINUOUS.violations(GOOD) == []


@pytest.mark.parametrize(
    ("array", "text"),
    [
        (np.zeros((4, 2), np.float32), "actions_continuous: shape (4, 2), expected (3, 2)"),
        (np.zeros((3, 3), np.float32), "shape (3, 3)"),
        (np.zeros(3, np.float32), "shape (3,)"),
        (GOOD.astype(np.float64), "actions_continuous: dtype float64, expected float32"),
        (GOOD + np.float32("nan"), "contains NaN or infinity"),
        (GOOD + np.float32("inf"), "contains NaN or infinity"),
        (np.array([[0, 0], [1.5, 0], [0, 0]], np.float32), "maximum 1.5 is above (1.0, 1.5)"),
        (np.array([[0, 0], [0, -2], [0, 0]], np.float32), "minimum -2.0 is below (0.0, -1.5)"),
    ],
)
def test_violation_names_the_expected_and_the_found_value(array: np.ndarray, text: str) -> None:
    assert any(text in found for found in ACTIONS_CONTINUOUS.violations(array, 3))


def test_both_bounds_are_reported_at_once() -> None:
    assert len(ACTIONS_TOKENS.violations(np.array([[-1, 7]], np.int16))) == 2


def test_open_extent_is_shown_as_t() -> None:
    assert POSES.violations(np.zeros((3, 6), np.float32)) == ["poses: shape (3, 6), expected (T, 7)"]


def test_an_empty_array_has_no_value_violations() -> None:
    assert ArraySpec("x", (None,), np.float32, "m", 0, 1).violations(np.zeros(0, np.float32)) == []


def test_depth_beyond_the_range_is_named_in_metres() -> None:
    depth = np.full(DEPTH_FRAME.shape, 31, np.float32)  # type: ignore[arg-type]
    assert DEPTH_FRAME.violations(depth) == ["depth_front: maximum 31.0 is above 30.0 m"]


def test_a_row_without_a_value_is_valid_and_half_a_row_is_not() -> None:
    labels = np.array([[0.5, 0.0], [np.nan, np.nan]], np.float32)
    assert EXPERT_ACTIONS.violations(labels) == []
    labels[1, 1] = 0.0
    assert EXPERT_ACTIONS.violations(labels) == ["expert_actions: contains NaN or infinity"]
    assert "maximum 2.0 is above" in EXPERT_ACTIONS.violations(np.array([[2.0, 0.0]], np.float32))[0]
