"""The protocol of an expert: what it is shown each step and what it answers."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from workers.sight import Sighting
from workers.slew import Twist

__all__ = ["Expert", "Observation"]


class Observation(NamedTuple):
    """What an expert may use; all but `sighting` is ground truth."""

    sighting: Sighting
    bearing_rad: float
    """Angle from the robot's heading to the target's centroid, counter-clockwise, in [-pi, pi]."""
    distance_m: float
    """Planar distance from base_link to the target's centroid."""
    obstacle_near: bool


class Expert(Protocol):
    """A controller; `act` is called once a step, in order."""

    def act(self, seen: Observation) -> Twist:
        """Returns the wanted twist, within the action bounds and before the slew limit."""
        ...
