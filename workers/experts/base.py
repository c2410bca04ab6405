"""The protocol of an expert: what it is shown each step and what it answers."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from schemas.scene import Target
from workers.experts.sight import Sighting
from workers.geometry.grid import Grid
from workers.geometry.pose import Pose
from workers.geometry.slew import Twist
from workers.planning import Waypoint

__all__ = ["Expert", "Senses"]


class Senses(Protocol):
    """What an expert may use; all but `sighting` is ground truth. What the camera shows may be looked at when asked."""

    @property
    def sighting(self) -> Sighting:
        """The target in the image."""

    @property
    def bearing_rad(self) -> float:
        """Angle from the robot's heading to the target's centroid, counter-clockwise, in [-pi, pi]."""

    @property
    def distance_m(self) -> float:
        """Planar distance from base_link to the target's centroid."""

    @property
    def obstacle_near(self) -> bool:
        """Whether something stands close before the camera."""

    @property
    def pose(self) -> Pose:
        """Of base_link in the world frame."""


@runtime_checkable
class Expert(Protocol):
    """A controller of one drive; `begin` is called once, then `act` once a step, in order."""

    def begin(self, start: Pose, grid: Grid, target: Target) -> tuple[Waypoint, ...] | None:
        """Returns the path it means to follow: empty where it follows none, `None` where it needs one and finds none.

        Args:
            start: pose of base_link at rest.
            grid: of the scene.
            target: to drive to.
        """
        ...

    def act(self, seen: Senses) -> Twist:
        """Returns the wanted twist, within the action bounds and before the slew limit."""
        ...
