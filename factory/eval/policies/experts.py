"""The experts as policies: they know the goal and the map, and the results say so."""

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
    """Drives as the collection's expert of that name does, from the same ground truth."""

    knows = "goal, map and instance ids"

    def __init__(self, expert: ExpertName) -> None:
        self.expert = expert

    def enter(self, situation: PrivilegedState) -> None:
        """Takes the running simulation."""
        self._situation = situation

    def reset(self, instruction: str, info: EpisodeInfo) -> None:  # noqa: ARG002
        """Plans, where the expert plans.

        Raises:
            PolicyFailure: it finds no way.
        """
        simulator = self._situation.simulator
        self._expert = make_expert(self._situation.job)
        start = simulator.observe().pose
        if self._expert.begin(start, simulator.place.grid, simulator.target) is None:
            where = f"({start.x:.2f}, {start.y:.2f}) m"
            raise PolicyFailure(PolicyFault.RAISED, f"no drivable path to {simulator.target.target_id} from {where}")

    def act(self, observation: PolicyInput) -> Twist:  # noqa: ARG002
        """Returns the wanted twist."""
        return self._expert.act(self._situation.simulator.observe())
