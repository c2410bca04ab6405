"""Parsing of actions: shapes, types, ranges, and messages for invalid answers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from factory.eval.driving.action import read_actions
from factory.eval.driving.policy import PolicyFailure, PolicyFault
from workers.geometry.slew import Twist


def read(answer: Any, kind: str = "continuous") -> Any:
    return read_actions(answer, kind, 1.0, 1.5)


@pytest.mark.parametrize(
    "answer", [(0.5, -1.0), [0.5, -1.0], np.array([0.5, -1.0], np.float32), Twist(0.5, -1.0), {"actions": [0.5, -1.0]}]
)
def test_a_pair_of_numbers_is_one_twist(answer: Any) -> None:
    assert read(answer).twists == (Twist(0.5, -1.0),)


def test_a_chunk_is_executed_in_order() -> None:
    assert read(np.array([[0.1, 0.0], [0.2, 0.0]])).twists == (Twist(0.1, 0.0), Twist(0.2, 0.0))


def test_tokens_are_converted_to_grid_points() -> None:
    assert read(np.array([6, 3]), "tokens").twists == (Twist(1.0, 0.0),)
    assert read({"tokens": [[0, 0], [3, 6]]}).twists == (Twist(0.0, -1.5), Twist(0.5, 1.5))


def test_integers_are_speeds_unless_the_policy_declares_tokens() -> None:
    assert read([0, 0]).twists == (Twist(0.0, 0.0),)


def test_actions_out_of_range_are_counted() -> None:
    assert read([[0.5, 0.0], [2.0, 0.0], [0.5, -9.0]]).beyond == 2


@pytest.mark.parametrize(
    ("answer", "kind", "message"),
    [
        (None, "continuous", r"found \(\)"),
        ("go", "continuous", "two numbers"),
        ([0.1, 0.2, 0.3], "continuous", r"shape \(2,\) or \(H, 2\).*found \(3,\)"),
        (np.zeros((0, 2)), "continuous", r"found \(0, 2\)"),
        (np.zeros((2000, 2)), "continuous", "up to 1000"),
        ([float("nan"), 0.0], "continuous", "finite numbers, found .*nan"),
        ([float("inf"), 0.0], "continuous", "finite"),
        ([7, 0], "tokens", "tokens 0 to 6"),
        ([0.5, 3], "tokens", "tokens 0 to 6"),
        ({"action": [0, 0]}, "continuous", r"'actions' or 'tokens', found \['action'\]"),
        ([0.0, 0.0], "joints", "continuous or tokens"),
    ],
)
def test_an_invalid_action_is_a_policy_failure_with_a_description(answer: Any, kind: str, message: str) -> None:
    with pytest.raises(PolicyFailure, match=message) as caught:
        read(answer, kind)
    assert caught.value.fault is PolicyFault.INVALID
