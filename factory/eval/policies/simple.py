"""Baseline policies: one that never moves and one with random twists. They do not use observations."""

from __future__ import annotations

import numpy as np

from factory.eval.driving.policy import BlindPolicy, EpisodeInfo, PolicyInput
from workers.geometry.slew import Twist

__all__ = ["RandomPolicy", "StopPolicy"]

_HELD_S = 0.5
"""Duration for which a random twist is held, seconds; with a new twist at every step, the slew limit would average
them out."""


class StopPolicy(BlindPolicy):
    """Policy that never moves."""

    def reset(self, instruction: str, info: EpisodeInfo) -> None:
        """Does nothing."""

    def act(self, observation: PolicyInput) -> Twist:  # noqa: ARG002
        """Returns a zero twist."""
        return Twist(0.0, 0.0)


class RandomPolicy(BlindPolicy):
    """Policy with uniformly random twists, one every half second, seeded by the episode."""

    def reset(self, instruction: str, info: EpisodeInfo) -> None:  # noqa: ARG002
        """Seeds the random generator."""
        self._info = info
        self._rng = np.random.default_rng(info.seed)
        self._held = max(1, round(_HELD_S * info.control_hz))

    def act(self, observation: PolicyInput) -> Twist:
        """Returns the twist of the current half second."""
        if observation["step"] % self._held == 0:
            v, w = (float(self._rng.uniform(*bounds)) for bounds in (self._info.v_range_mps, self._info.w_range_rps))
            self._twist = Twist(v, w)
        return self._twist
