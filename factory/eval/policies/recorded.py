"""Open loop: recorded actions carried out blindly, the episode's own (about 1) or another one's (about 0)."""

from __future__ import annotations

from factory.eval.driving.policy import EpisodeInfo, PolicyInput, PrivilegedPolicy, PrivilegedState
from schemas.errors import UsageError
from workers.geometry.slew import Twist

__all__ = ["PlaybackPolicy", "ReplayPolicy"]


class _Recorded(PrivilegedPolicy):
    """Carries out the actions that the situation holds, then stands still."""

    def enter(self, situation: PrivilegedState) -> None:
        """Takes the actions."""
        if situation.actions is None:
            raise UsageError(f"{situation.simulator.spec.spec_id} does not come from an archived episode")
        self._actions = situation.actions

    def reset(self, instruction: str, info: EpisodeInfo) -> None:
        """Has nothing to forget."""

    def act(self, observation: PolicyInput) -> Twist:
        """Returns the action that was recorded at this step."""
        step = observation["step"]
        return Twist(*self._actions[step]) if step < len(self._actions) else Twist(0.0, 0.0)


class ReplayPolicy(_Recorded):
    """The episode's own actions: a test of determinism, whose success rate is about 1."""

    knows = "the episode's recorded actions"


class PlaybackPolicy(_Recorded):
    """Another episode's actions: what driving without looking is worth, about 0."""

    knows = "another episode's recorded actions"
