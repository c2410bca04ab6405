"""The floor of every table: a policy that stands still and one that drives at random."""

from __future__ import annotations

import numpy as np

from factory.eval.driving.policy import BlindPolicy, EpisodeInfo, PolicyInput
from workers.geometry.slew import Twist

__all__ = ["RandomPolicy", "StopPolicy"]

_HELD_S = 0.5
"""How long a random twist is held; drawn anew at every step, the slew limit would average it away."""


class StopPolicy(BlindPolicy):
    """Never moves."""

    def reset(self, instruction: str, info: EpisodeInfo) -> None:
        """Has nothing to forget."""

    def act(self, observation: PolicyInput) -> Twist:  # noqa: ARG002
        """Returns standstill."""
        return Twist(0.0, 0.0)


class RandomPolicy(BlindPolicy):
    """Uniform twists over the action range, one every half second, by the episode's seed."""

    def reset(self, instruction: str, info: EpisodeInfo) -> None:  # noqa: ARG002
        """Seeds itself."""
        self._info = info
        self._rng = np.random.default_rng(info.seed)
        self._held = max(1, round(_HELD_S * info.control_hz))

    def act(self, observation: PolicyInput) -> Twist:
        """Returns the twist of this half second."""
        if observation["step"] % self._held == 0:
            v, w = (float(self._rng.uniform(*bounds)) for bounds in (self._info.v_range_mps, self._info.w_range_rps))
            self._twist = Twist(v, w)
        return self._twist
