"""Open-loop policies: replay recorded actions of the same episode (SR about 1) or of another one (SR about 0).

They do not use observations.
"""

from __future__ import annotations

from factory.eval.driving.policy import EpisodeInfo, PolicyInput, PrivilegedPolicy, PrivilegedState
from schemas.errors import UsageError
from workers.geometry.slew import Twist

__all__ = ["PlaybackPolicy", "ReplayPolicy"]


class _Recorded(PrivilegedPolicy):
    """Policy that executes the actions in the privileged state, then stops."""

    def enter(self, state: PrivilegedState) -> None:
        """Stores the recorded actions."""
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
    """Policy that replays the actions of another episode: the success rate without observations, about 0."""

    knows = "another episode's recorded actions"
