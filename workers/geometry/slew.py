"""The limit on how fast the commanded twist may change, as the real robot's velocity smoother has it.

A pure function of two twists and the period; never a controller and never physics.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from schemas.config import RobotConfig

__all__ = ["Twist", "slew"]


class Twist(NamedTuple):
    """A planar velocity of base_link."""

    v_mps: float
    """Forward speed, m/s."""
    w_rps: float
    """Yaw rate, rad/s, counter-clockwise positive."""


def slew(current: Twist, wanted: Twist, robot: RobotConfig, dt: float) -> Twist:
    """Returns the twist to command next: `wanted`, held to the accelerations the robot can do.

    Without the limit the wheels slip by half a metre a second and the robot drifts 25 cm over 6 m
    (docs/design/robot.md#limits-of-commands). The limits of speed itself are not applied here. The twist is rounded
    to float32, the precision it is recorded in, so that what was recorded is what was carried out, and carrying it
    out again gives the same poses: slewing towards a recorded twist returns it unchanged.

    Args:
        current: the twist commanded in the period before.
        wanted: the twist the driver asks for.
        robot: gives the limits of speeding up, braking (m/s2) and turning (rad/s2).
        dt: the control period, seconds.
    """
    yaw_step = robot.max_yaw_acceleration_rps2 * dt
    turned = min(max(wanted.w_rps, current.w_rps - yaw_step), current.w_rps + yaw_step)
    return Twist(float(np.float32(_slew_speed(current.v_mps, wanted.v_mps, robot, dt))), float(np.float32(turned)))


def _slew_speed(current: float, wanted: float, robot: RobotConfig, dt: float) -> float:
    """Moves the speed towards `wanted`; braking means towards zero, and a reversal brakes first."""
    if current < 0:
        return -_slew_speed(-current, -wanted, robot, dt)
    if wanted >= current:
        return min(wanted, current + robot.max_acceleration_mps2 * dt)
    if current == 0:
        return max(wanted, -robot.max_acceleration_mps2 * dt)
    return max(wanted, 0.0, current - robot.max_braking_mps2 * dt)
