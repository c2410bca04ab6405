"""Built-in policies: no motion, random twists, replay of recorded actions, and the experts. Plans no paths itself.

The baselines do not use observations. The experts use the goal and the map; the results state this.
"""

from __future__ import annotations

import numpy as np

from factory.eval.driving.policy import (
    BlindPolicy,
    EpisodeInfo,
    PolicyFailure,
    PolicyFault,
    PolicyInput,
    PrivilegedPolicy,
    PrivilegedState,
)
from schemas.errors import UsageError
from schemas.terms import ExpertName
from workers.experts import make_expert
from workers.geometry.slew import Twist

_HELD_S = 0.5
"""Duration for which a random twist is held, seconds. If the twist changed at every step, the slew limit would keep
the robot near the mean twist."""


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


class _Recorded(PrivilegedPolicy):
    """Policy that executes the actions in the privileged state, then stops."""

    def enter(self, state: PrivilegedState) -> None:
        if state.actions is None:
            raise UsageError(f"{state.simulator.spec.spec_id} does not come from an archived episode")
        self._actions = state.actions

    def reset(self, instruction: str, info: EpisodeInfo) -> None:
        """Does nothing."""

    def act(self, observation: PolicyInput) -> Twist:
        """Returns the recorded action of this step, and zero after the last one."""
        step = observation["step"]
        return Twist(*self._actions[step]) if step < len(self._actions) else Twist(0.0, 0.0)


class ReplayPolicy(_Recorded):
    """Policy that replays the actions of the same episode: a test of determinism with a success rate of about 1."""

    knows = "the episode's recorded actions"


class PlaybackPolicy(_Recorded):
    """Policy that executes the recorded actions of another episode: a baseline with a success rate of about 0."""

    knows = "another episode's recorded actions"


class ExpertPolicy(PrivilegedPolicy):
    """Policy that runs an expert of the data collection, with the same ground truth."""

    knows = "goal, map and instance ids"

    def __init__(self, expert: ExpertName) -> None:
        self.expert = expert

    def enter(self, state: PrivilegedState) -> None:
        self._state = state

    def reset(self, instruction: str, info: EpisodeInfo) -> None:  # noqa: ARG002
        """Starts the expert, which plans a path if it uses one.

        Raises:
            PolicyFailure: The expert finds no path.
        """
        simulator = self._state.simulator
        self._expert = make_expert(self._state.job)
        start = simulator.observe().pose
        if self._expert.begin(start, simulator.loaded.grid, simulator.target) is None:
            where = f"({start.x:.2f}, {start.y:.2f}) m"
            raise PolicyFailure(PolicyFault.RAISED, f"no drivable path to {simulator.target.target_id} from {where}")

    def act(self, observation: PolicyInput) -> Twist:  # noqa: ARG002
        return self._expert.act(self._state.simulator.observe())
