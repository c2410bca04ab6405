"""Wheel odometry of a differential drive: encoder ticks from the commanded twists, and the pose from the ticks.

Computes a whole episode; a prefix of an episode gives a prefix of the measurements.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from schemas.rig.noise import OdometryNoise
from schemas.rig.sensors import WheelOdometry
from schemas.support.numpy_types import Floats, Ints
from schemas.support.portable import cos, sin
from workers.sensors.streams import Effect, NoiseKey


@dataclass(frozen=True)
class OdometryMeasurements:
    """N measurements of an episode, one at every `stride`-th control step from the first."""

    ticks: Ints
    """(N, 2) encoder counts of the left and the right wheel since the start."""
    poses: Floats
    """(N, 3) x, y, metres, and heading, radians (not wrapped), in the frame of base_link at the start."""
    twists: Floats
    """(N, 2) mean forward speed, m/s, and yaw rate, rad/s, since the previous measurement."""


def sense_odometry(odometry: WheelOdometry, twists: Floats, control_hz: int, key: NoiseKey) -> OdometryMeasurements:
    """Returns the measurements of the wheel encoders in an episode.

    The motors turn the wheels as commanded, and the tyres slip on the floor: in PyBullet the wheel joints follow the
    commands to 2 mm over a drive of 4 m, while the robot drives a distance that is 0.4 % shorter. So the ticks are
    computed from the commands; only the recorded poses contain the slip of the simulation, which ticks from poses would
    hide.

    Args:
        odometry: nominal dimensions of the drive, ticks of the encoders, and noise.
        twists: (T, 2) commanded forward speed, m/s, and yaw rate, rad/s, of each step, as recorded.
        control_hz: control rate, steps per second.
        key: identity of the sensor in the episode, which determines the noise.
    """
    travel = wheel_travels(twists.astype(np.float64) / control_hz, odometry.track_m)
    radii = np.full(2, odometry.wheel_radius_m)
    if odometry.noise is not None:
        travel += slip(odometry.noise, travel, key)
        radii *= 1 + odometry.noise.radius_error_std * key.normals(Effect.WHEEL_RADIUS, 2).astype(np.float64)
    unit = 2 * math.pi / odometry.ticks_per_turn
    stride = odometry.stride(control_hz)
    ticks = np.floor(np.cumsum(travel, axis=0) / (radii * unit)).astype(np.int64)[::stride]
    left, right = np.diff(ticks, axis=0, prepend=0).T * (unit * odometry.wheel_radius_m)
    forward, turn = (left + right) / 2, (right - left) / odometry.track_m
    rates = np.stack((forward, turn), axis=1) * (control_hz / stride)
    return OdometryMeasurements(ticks, dead_reckoning(forward, turn), rates)


def wheel_travels(moves: Floats, track_m: float) -> Floats:
    """Returns the distances (T, 2) that the left and the right wheel roll from the previous step to each step, metres.

    Args:
        moves: (T, 2) forward distance, metres, and turn, radians, during each step; the last one is not used.
        track_m: distance between the wheels, metres.
    """
    before = np.concatenate((np.zeros((1, 2)), moves[:-1]))
    half = before[:, 1] * track_m / 2
    return np.stack((before[:, 0] - half, before[:, 0] + half), axis=1)


def slip(noise: OdometryNoise, travels: Floats, key: NoiseKey) -> Floats:
    """Returns the additional slip (T, 2) of each wheel and step, metres.

    Its variance is proportional to the travel (K. S. Chong and L. Kleeman, "Accurate odometry and error modelling for a
    mobile robot", ICRA 1997), so the error after a distance does not depend on the control rate.
    """
    normals = key.normals(Effect.WHEEL_SLIP, travels.shape).astype(np.float64)
    return np.asarray(noise.slip_std_m * np.sqrt(np.abs(travels)) * normals)


def dead_reckoning(forward: Floats, turn: Floats) -> Floats:
    """Returns poses (N, 3) x, y, heading from forward distances (N,), metres, and turns (N,), radians, of each step.

    Each step moves along its mean heading (J. Borenstein and L. Feng, "Measurement and correction of systematic
    odometry errors in mobile robots", IEEE Transactions on Robotics and Automation 12(6), 1996).
    """
    headings = np.cumsum(turn)
    middle = headings - turn / 2
    return np.stack((np.cumsum(forward * cos(middle)), np.cumsum(forward * sin(middle)), headings), axis=1)
