"""Acceleration limit of the commanded twist, like the velocity smoother of the real robot.

A pure function of two twists and the control period. Contains no controller and no physics.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from schemas.config import RobotConfig


class Twist(NamedTuple):
    """Planar velocity of base_link."""

    v_mps: float
    """Forward speed, m/s."""
    w_rps: float
    """Yaw rate, rad/s, counter-clockwise positive."""


def slew(current: Twist, wanted: Twist, robot: RobotConfig, dt: float) -> Twist:
    """Returns the next commanded twist: `wanted` within the acceleration limits of the robot.

    Without the limit the wheels slip by half a metre per second and the robot drifts 25 cm over 6 m
    (docs/design/robot.md#limits-of-commands). The speed limits are not applied here. The twist is rounded to float32,
    the precision of the recording, so a replay of the recorded twists gives the same poses: the limit returns a
    recorded twist unchanged.

    Args:
        current: twist of the previous control period.
        wanted: twist that the controller requests.
        robot: robot, with the limits of acceleration and braking (m/s2) and of yaw acceleration (rad/s2).
        dt: control period, seconds.
    """
    yaw_step = robot.max_yaw_acceleration_rps2 * dt
    turned = min(max(wanted.w_rps, current.w_rps - yaw_step), current.w_rps + yaw_step)
    return Twist(float(np.float32(_slew_speed(current.v_mps, wanted.v_mps, robot, dt))), float(np.float32(turned)))


def _slew_speed(current: float, wanted: float, robot: RobotConfig, dt: float) -> float:
    """Returns the next speed towards `wanted`; braking is a change towards zero, and a reversal brakes first."""
    if current < 0:
        return -_slew_speed(-current, -wanted, robot, dt)
    if wanted >= current:
        return min(wanted, current + robot.max_acceleration_mps2 * dt)
    if current == 0:
        return max(wanted, -robot.max_acceleration_mps2 * dt)
    return max(wanted, 0.0, current - robot.max_braking_mps2 * dt)
