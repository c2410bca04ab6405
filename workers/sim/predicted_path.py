"""Predicts the path of a controller that drives straight to its target, without physics and rendering.

The model is a unicycle with the gains of the proportional expert and the robot's slew limits. It steers by the column
of the target's mask, or by the bearing if the mask is too small. It helps to select start poses. It does not predict
how an episode ends.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from schemas.job import Job
from schemas.measure import Goal
from workers.geometry.mask_estimate import MaskEstimate
from workers.geometry.slew import Twist, slew

_HZ = 20
"""Predicted poses per second; at full speed they are one cell of the grid apart."""
_LOOK_EVERY = 3
"""Number of poses between two evaluations of the mask, which take most of the time."""


def predict_path(
    start: tuple[float, float, float], goal: Goal, job: Job, estimate: MaskEstimate | None = None
) -> NDArray[np.float64]:
    """Returns the predicted poses (N, 3) x, y, yaw from `start` to the success region, metres and radians.

    Args:
        start: x, y in metres and yaw in radians of base_link, at rest.
        goal: goal of the episode.
        job: job, with gains, slew limits and the step limit.
        estimate: estimate of the mask of the target, for steering by its mask; `None` for steering by the centroid.
    """
    gains, robot = job.gains, job.robot
    x, y, yaw = start
    centre_x, centre_y = goal.centre_m
    twist = Twist(0.0, 0.0)
    poses = [start]
    pixels = column = 0.0
    for step in range(job.task.max_steps * _HZ // job.task.control_hz):
        distance = goal.distance(x, y)
        if distance <= goal.radius_m:
            break
        if estimate is not None and step % _LOOK_EVERY == 0:
            pixels, column = estimate.evaluate(x, y, yaw)
        error = (
            -column
            if pixels >= gains.min_mask_px
            else math.remainder(math.atan2(centre_y - y, centre_x - x) - yaw, 2 * math.pi)
        )
        turn = min(max(gains.yaw_gain * error, -robot.max_yaw_rate_rps), robot.max_yaw_rate_rps)
        twist = slew(twist, Twist(min(gains.speed_gain * distance, robot.max_speed_mps), turn), robot, 1.0 / _HZ)
        yaw += twist.w_rps / _HZ
        x += twist.v_mps * math.cos(yaw) / _HZ
        y += twist.v_mps * math.sin(yaw) / _HZ
        poses.append((x, y, yaw))
    return np.array(poses)
