"""Experts as policies. They use the goal and the map; the results state this. Plans no paths itself."""

from __future__ import annotations

from factory.eval.driving.policy import (
    EpisodeInfo,
    PolicyFailure,
    PolicyFault,
    PolicyInput,
    PrivilegedPolicy,
    PrivilegedState,
)
from schemas.terms import ExpertName
from workers.experts import make_expert
from workers.geometry.slew import Twist

__all__ = ["ExpertPolicy"]


class ExpertPolicy(PrivilegedPolicy):
    """Policy that runs the expert of data collection of that name, with the same ground truth."""

    knows = "goal, map and instance ids"

    def __init__(self, expert: ExpertName) -> None:
        self.expert = expert

    def enter(self, state: PrivilegedState) -> None:
        """Stores the privileged state."""
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
        """Returns the twist of the expert."""
        return self._expert.act(self._state.simulator.observe())
