"""A policy may state where it located the named object; other values are a failure of the policy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from factory.eval.driving.policy import EpisodeInfo, PolicyFailure, PolicyInput, attention_of


class Looking:
    def __init__(self, attention: Any) -> None:
        self.attention = attention

    def reset(self, instruction: str, info: EpisodeInfo) -> None: ...

    def act(self, observation: PolicyInput) -> tuple[float, float]:
        return 0.0, 0.0


@pytest.mark.parametrize("value", [(0.5, 0, 1), np.array((0.5, 0.0, 1.0)), [0.5, 0.0, 1.0]])
def test_three_fractions_are_accepted(value: Any) -> None:
    assert attention_of(Looking(value)) == (0.5, 0.0, 1.0)


def test_none_means_nowhere() -> None:
    assert attention_of(Looking(None)) is None


@pytest.mark.parametrize(
    "value", [(0.5, 0.5), (0.5, 0.5, 1.1), (-0.1, 0, 0), (float("nan"), 0, 0), "left", 3, ("a",) * 3]
)
def test_anything_else_is_a_failure_of_the_policy(value: Any) -> None:
    with pytest.raises(PolicyFailure, match="column, row and confidence from 0 to 1 are expected"):
        attention_of(Looking(value))
