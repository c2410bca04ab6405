"""Protocols of an expert and of its observation at each step. Implements no expert."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from schemas.scene import Target
from workers.experts.observation import MaskMeasures
from workers.geometry.grid import Grid
from workers.geometry.pose import Pose
from workers.geometry.slew import Twist
from workers.planning import Waypoint


class ExpertObservation(Protocol):
    """Observation of an expert: `target_mask` and `obstacle_near` are measured in an image, the rest is exact."""

    @property
    def target_mask(self) -> MaskMeasures:
        """Measurements of the target in the image."""

    @property
    def bearing_rad(self) -> float:
        """Angle from the robot's heading to the target's centroid, counter-clockwise, in [-pi, pi], radians."""

    @property
    def distance_m(self) -> float:
        """Planar distance from base_link to the target by the success measure, metres."""

    @property
    def obstacle_near(self) -> bool:
        """Whether an obstacle is close in front of the camera."""

    @property
    def pose(self) -> Pose:
        """Pose of base_link in the world frame."""


@runtime_checkable
class Expert(Protocol):
    """Controller of one episode; the caller calls `begin` once, then `act` at each step."""

    def begin(self, start: Pose, grid: Grid, target: Target) -> tuple[Waypoint, ...] | None:
        """Prepares the controller and returns its planned path.

        Args:
            start: pose of base_link at rest.
            grid: occupancy grid of the scene.
            target: target to drive to.

        Returns:
            The path; empty for an expert without a plan, `None` if the expert needs a path and none exists.
        """
        ...

    def act(self, seen: ExpertObservation) -> Twist:
        """Returns the desired twist, within the action bounds and before the slew limit."""
        ...
