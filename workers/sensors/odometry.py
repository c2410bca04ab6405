"""Wheel odometry of a differential drive: encoder ticks of an exact trajectory, and the pose that they give.

Computes a whole episode; a prefix of an episode gives a prefix of the measurements.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from schemas.rig.motion import WheelOdometry
from schemas.rig.noise import OdometryNoise
from schemas.support.numpy_types import Floats, Ints
from schemas.support.portable import arctan2, cos, sin
from workers.sensors.streams import Effect, NoiseKey


@dataclass(frozen=True)
class OdometryMeasurements:
    """Measurements of an episode; N is every `stride`-th control step from the first."""

    ticks: Ints
    """(N, 2) encoder counts of the left and the right wheel since the start."""
    poses: Floats
    """(N, 3) x, y, metres, and heading, radians (not wrapped), in the frame of base_link at the start."""
    twists: Floats
    """(N, 2) mean forward speed, m/s, and yaw rate, rad/s, since the previous measurement."""


def sense_odometry(odometry: WheelOdometry, poses: Floats, control_hz: int, key: NoiseKey) -> OdometryMeasurements:
    """Returns the measurements of the wheel encoders along a trajectory.

    Args:
        odometry: measures of the drive and of the encoders, as the odometry knows them.
        poses: (T, 7) recorded poses of base_link in the world.
        control_hz: control rate, steps per second.
        key: identity of the sensor in the episode, which determines the noise.
    """
    noise = odometry.noise or OdometryNoise()
    travel = wheel_travels(poses, odometry.track_m)
    travel += slip(noise, travel, key)
    radii = odometry.wheel_radius_m * (1 + noise.radius_error_std * key.normals(Effect.WHEEL_RADIUS, 2).astype(float))
    turns = np.cumsum(travel, axis=0) / (2 * math.pi * radii)
    stride = odometry.stride(control_hz)
    ticks = np.floor(turns * odometry.ticks_per_turn).astype(np.int64)[::stride]
    steps = np.diff(ticks, axis=0, prepend=ticks[:1]) * (
        2 * math.pi * odometry.wheel_radius_m / odometry.ticks_per_turn
    )
    forward, turn = steps.mean(axis=1), (steps[:, 1] - steps[:, 0]) / odometry.track_m
    return OdometryMeasurements(
        ticks, dead_reckoning(forward, turn), np.stack((forward, turn), axis=1) * control_hz / stride
    )


def wheel_travels(poses: Floats, track_m: float) -> Floats:
    """Returns how far the left and the right wheel roll in each step (T, 2), metres, if they do not slip.

    The displacement is projected on the mean heading of the step (J. Borenstein and L. Feng, "Measurement and correction
    of systematic odometry errors in mobile robots", IEEE Transactions on Robotics and Automation 12(6), 1996, Eq. 1.5).
    """
    w, x, y, z = poses[:, 3:].T
    yaws = np.unwrap(arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    moved, turned = np.diff(poses[:, :2], axis=0), np.diff(yaws)
    middle = yaws[:-1] + turned / 2
    forward = moved[:, 0] * cos(middle) + moved[:, 1] * sin(middle)
    half = turned * track_m / 2
    return np.concatenate((np.zeros((1, 2)), np.stack((forward - half, forward + half), axis=1)))


def slip(noise: OdometryNoise, travels: Floats, key: NoiseKey) -> Floats:
    """Returns the slip (T, 2) of each wheel and step, metres.

    Its variance is proportional to the travel (K. S. Chong and L. Kleeman, "Accurate odometry and error modelling for a
    mobile robot", ICRA 1997, Sec. 4), so that the error after a distance does not depend on the control rate.
    """
    normals = key.normals(Effect.WHEEL_SLIP, travels.shape).astype(np.float64)
    return np.asarray(noise.slip_std_m * np.sqrt(np.abs(travels)) * normals)


def dead_reckoning(forward: Floats, turn: Floats) -> Floats:
    """Returns poses (N, 3) x, y, heading from forward distances (N,), metres, and turns (N,), radians, of each step."""
    headings = np.cumsum(turn)
    middle = headings - turn / 2
    return np.stack((np.cumsum(forward * cos(middle)), np.cumsum(forward * sin(middle)), headings), axis=1)
