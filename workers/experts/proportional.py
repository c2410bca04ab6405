"""Proportional expert (paper Eq. 2-5) and its speed laws; it steers by the target's mask, or else by the bearing.

Reacts to obstacles with the paper's speed limit only. It cannot drive around corners.
"""

from __future__ import annotations

from collections.abc import Callable

from schemas.config import ExpertConfig
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.job import Job
from schemas.scene import Target
from workers.experts.base import ExpertObservation
from workers.geometry.grid import Grid
from workers.geometry.pose import Pose
from workers.geometry.slew import Twist
from workers.planning import Waypoint

SpeedLaw = Callable[[ExpertObservation, ExpertConfig, float], float]
"""Function (observation, gains, success radius in metres) -> speed in m/s before clamping."""


def centroid_speed(seen: ExpertObservation, gains: ExpertConfig, radius_m: float) -> float:
    """Returns k_v * d for the distance d by the success measure, and 0 inside the region, m/s; published behaviour."""
    return gains.speed_gain * seen.distance_m if seen.distance_m > radius_m else 0.0


def depth_speed(seen: ExpertObservation, gains: ExpertConfig, radius_m: float) -> float:
    """Returns k_v * (median mask depth) if the target is visible, else k_v * d; 0 inside the circle, m/s."""
    if seen.distance_m <= radius_m:
        return 0.0
    return gains.speed_gain * (seen.target_mask.measure_depth() if _is_visible(seen, gains) else seen.distance_m)


def literal_speed(seen: ExpertObservation, gains: ExpertConfig, radius_m: float) -> float:
    """Returns paper Eq. 3 and 5 as printed: k_v * (median mask depth - radius) if visible, else k_v * d, m/s.

    The depth is measured from the camera to the surface, and the speed reaches 0 before the base is within the radius
    of the centroid. So every episode with this law ends with a timeout (docs/design/experts.md#proportional-expert).
    """
    if _is_visible(seen, gains):
        return gains.speed_gain * (seen.target_mask.measure_depth() - radius_m)
    return gains.speed_gain * seen.distance_m


class ProportionalExpert:
    """Expert that computes the yaw rate from the mask's column or the bearing, and the speed from a speed law.

    The speed is limited near obstacles.
    """

    def __init__(self, job: Job, speed_law: SpeedLaw) -> None:
        self._gains = job.gains
        self._robot = job.robot
        self._radius_m = job.task.success_radius_m
        self._speed_law = speed_law

    def begin(self, start: Pose, grid: Grid, target: Target) -> tuple[Waypoint, ...]:  # noqa: ARG002
        """Returns an empty path, because this expert plans none."""
        return ()

    def act(self, seen: ExpertObservation) -> Twist:
        """Returns the desired twist; zero speed and yaw rate once the speed law gives 0 inside the circle."""
        gains = self._gains
        speed = self._speed_law(seen, gains, self._radius_m)
        if speed <= 0.0 and seen.distance_m <= self._radius_m:
            return Twist(0.0, 0.0)  # before `target_mask`, which would render an image, the slowest part of a step
        if speed > gains.avoidance_speed_mps and seen.obstacle_near:
            speed = gains.avoidance_speed_mps
        half = FRAME_SIZE_PX / 2
        error = -(seen.target_mask.column - half) / half if _is_visible(seen, gains) else seen.bearing_rad
        limit = self._robot.max_yaw_rate_rps
        return Twist(
            min(max(speed, 0.0), self._robot.max_speed_mps),
            min(max(gains.yaw_gain * error, -limit), limit),
        )


def _is_visible(seen: ExpertObservation, gains: ExpertConfig) -> bool:
    return seen.target_mask.pixels >= gains.min_mask_px
