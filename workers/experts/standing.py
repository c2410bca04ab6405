"""Expert of episodes with a false premise: it stands still, because the named object does not exist."""

from __future__ import annotations

from schemas.scene import Target
from workers.experts.base import ExpertObservation
from workers.geometry.grid import Grid
from workers.geometry.pose import Pose
from workers.geometry.slew import Twist
from workers.planning import Waypoint


class StandingExpert:
    """Expert that commands no motion."""

    def begin(self, start: Pose, grid: Grid, target: Target) -> tuple[Waypoint, ...]:  # noqa: ARG002
        return ()

    def act(self, seen: ExpertObservation) -> Twist:  # noqa: ARG002
        return Twist(0.0, 0.0)
