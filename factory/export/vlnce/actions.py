"""Discrete actions of VLN-CE that follow a driven path: stop, forward 0.25 m, left and right 15 degrees.

The agent is a point that moves exactly by its actions; it does not collide. Pure functions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from schemas.support.geometry import yaw_of
from schemas.support.numpy_types import Floats

STOP, FORWARD, LEFT, RIGHT = 0, 1, 2, 3
"""Actions of VLN-CE."""
STEP_M, TURN_RAD = 0.25, math.radians(15.0)
"""Motion of an action of VLN-CE."""
_AHEAD_M = 0.3
"""Points of the path that are nearer than this count as reached, metres. It must exceed a step, so each step brings the
agent nearer to the next point, and the path ends."""

Point = tuple[float, float]


class _Agent:
    """Point with a heading, which records its actions."""

    def __init__(self, place: Point, yaw_rad: float) -> None:
        self.place, self.yaw_rad = place, yaw_rad
        self.actions: list[int] = []

    def face(self, yaw_rad: float) -> None:
        """Turns until the heading is at most half a turn off."""
        turns = round(math.remainder(yaw_rad - self.yaw_rad, 2 * math.pi) / TURN_RAD)
        self.actions += [LEFT if turns > 0 else RIGHT] * abs(turns)
        self.yaw_rad += turns * TURN_RAD

    def approach(self, point: Point) -> None:
        """Turns towards a point and moves one step."""
        self.face(self.bearing_of(point))
        self.actions.append(FORWARD)
        self.place = self._ahead()

    def would_approach(self, point: Point) -> bool:
        """Returns whether `approach` reduces the distance to a point."""
        trial = _Agent(self.place, self.yaw_rad)
        trial.approach(point)
        return math.dist(trial.place, point) < math.dist(self.place, point)

    def bearing_of(self, point: Point) -> float:
        return math.atan2(point[1] - self.place[1], point[0] - self.place[0])

    def _ahead(self) -> Point:
        return (
            self.place[0] + STEP_M * math.cos(self.yaw_rad),
            self.place[1] + STEP_M * math.sin(self.yaw_rad),
        )


def discrete_actions(poses: Floats, goals: Sequence[Point], radius_m: float) -> list[int]:
    """Returns the actions that follow a driven path from its first pose and end with one stop.

    The agent ends about half a step from the last pose, or nearer, and has its heading to half a turn. If every goal is
    then farther than the radius, because the drive ended at the border of the success region, the agent moves one step
    towards the nearest goal, which is enough.

    Args:
        poses: (T, 7) poses of base_link: x, y, z metres, and a quaternion w, x, y, z.
        goals: goals x, y, metres; success is a distance of at most `radius_m` to one of them.
        radius_m: success radius, metres.
    """
    yaw, path = yaw_of(poses), [(x, y) for x, y in poses[:, :2].tolist()]
    agent = _Agent(path[0], float(yaw[0]))
    for point in path[:-1]:
        while math.dist(agent.place, point) >= _AHEAD_M:
            agent.approach(point)
    while agent.would_approach(path[-1]):
        agent.approach(path[-1])
    nearest = min(goals, key=lambda goal: math.dist(goal, agent.place))
    if math.dist(nearest, agent.place) > radius_m:
        agent.approach(nearest)
    agent.face(float(yaw[-1]))
    return [*agent.actions, STOP]
