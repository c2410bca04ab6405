"""Inertial measurement unit: angular velocity and specific force of a moving sensor frame, with bias and noise.

Computes a whole episode from its exact poses. The first measurements do not depend on later poses, so a prefix of
an episode gives a prefix of the measurements.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from schemas.rig.noise import ImuNoise
from schemas.rig.sensors import Imu
from schemas.support.numpy_types import Floats, Singles
from schemas.support.portable import arctan2
from workers.geometry.camera import mount_rotation
from workers.sensors.frames import sensor_poses, turned
from workers.sensors.streams import Effect, NoiseKey

GRAVITY_MPS2 = 9.81
"""Gravity of the simulation, along -z of the world, m/s2."""


@dataclass(frozen=True)
class ImuMeasurements:
    """N measurements of an episode in the sensor frame, one at every `stride`-th control step from the first."""

    angular_velocity: Singles
    """(N, 3) mean angular velocity since the previous measurement, rad/s."""
    specific_force: Singles
    """(N, 3) acceleration minus gravity, m/s2; +9.81 along z for a level sensor at rest."""


def sense_imu(imu: Imu, poses: Floats, control_hz: int, key: NoiseKey) -> ImuMeasurements:
    """Returns the measurements of an IMU along a trajectory.

    Args:
        imu: model with its mounting pose.
        poses: (T, 7) recorded poses of base_link in the world.
        control_hz: control rate, steps per second.
        key: identity of the sensor in the episode, which determines the noise.
    """
    stride = imu.stride(control_hz)
    sampled, rate_hz = poses[::stride], control_hz / stride
    rates = angular_velocities(sampled, rate_hz)
    gyro = turned(mount_rotation(imu.mount).T[None], rates)
    force = specific_forces(*sensor_poses(sampled, imu.mount), rate_hz)
    if imu.noise is not None:
        errors = imu_errors(imu.noise, len(sampled), rate_hz, key)
        gyro, force = gyro + errors[:, :3], force + errors[:, 3:]
    gyro = np.clip(gyro, -imu.gyro_range_rps, imu.gyro_range_rps)
    force = np.clip(force, -imu.accelerometer_range_mps2, imu.accelerometer_range_mps2)
    return ImuMeasurements(gyro.astype(np.float32), force.astype(np.float32))


def angular_velocities(poses: Floats, rate_hz: float) -> Floats:
    """Returns mean angular velocities (N, 3) of base_link since the previous pose, in base_link, rad/s.

    The quaternion q[k-1]* q[k] of two poses (N, 7) contains the axis of the rotation between them, and half its angle.
    The first angular velocity is 0.
    """
    now, before = poses[1:, 3:], poses[:-1, 3:]
    (w0, x0, y0, z0), (w1, x1, y1, z1) = before.T, now.T
    w = w0 * w1 + x0 * x1 + y0 * y1 + z0 * z1
    x = w0 * x1 - x0 * w1 - y0 * z1 + z0 * y1
    y = w0 * y1 + x0 * z1 - y0 * w1 - z0 * x1
    z = w0 * z1 - x0 * y1 + y0 * x1 - z0 * w1
    axis = np.stack((x, y, z), axis=1) * np.where(w < 0, -1.0, 1.0)[:, None]
    sine = np.sqrt((axis * axis).sum(axis=1))
    half = arctan2(sine, np.abs(w))
    scale = np.where(sine > 1e-12, 2 * half / np.maximum(sine, 1e-12), 2.0) * rate_hz
    return np.concatenate((np.zeros((1, 3)), axis * scale[:, None]))


def specific_forces(positions: Floats, frames: Floats, rate_hz: float) -> Floats:
    """Returns specific forces (N, 3) in the sensor frame, m/s2.

    The acceleration is the second difference of the positions (N, 3) of the sensor, so it contains the centripetal
    and tangential acceleration of the lever arm. It is the acceleration at the previous position, so the rotation
    (N, 3, 3) at that position converts it to the sensor frame. Before the first pose the robot is at rest.
    """
    start = positions[:1]
    path = np.concatenate((start, start, positions))
    acceleration = (path[2:] - 2 * path[1:-1] + path[:-2]) * rate_hz**2
    acceleration[:, 2] += GRAVITY_MPS2
    previous = np.concatenate((frames[:1], frames[:-1]))
    return turned(previous.transpose(0, 2, 1), acceleration)


def imu_errors(noise: ImuNoise, count: int, rate_hz: float, key: NoiseKey) -> Floats:
    """Returns the errors (count, 6) of gyroscope, rad/s, and accelerometer, m/s2: bias plus white noise.

    The standard deviation of the white noise is the noise density x sqrt(rate). The standard deviation of a step of the
    bias is the random walk / sqrt(rate) (Kalibr, "IMU noise model"; N. Trawny and S. I. Roumeliotis, "Indirect Kalman
    filter for 3D attitude estimation", 2005, Sec. 2.1).
    """
    normals = key.normals(Effect.IMU_STEPS, (count, 2, 6)).astype(np.float64)
    white = normals[:, 0] * _per_axis(noise.gyro_white, noise.accelerometer_white) * math.sqrt(rate_hz)
    steps = normals[:, 1] * _per_axis(noise.gyro_walk, noise.accelerometer_walk) / math.sqrt(rate_hz)
    steps[0] = key.normals(Effect.IMU_START, 6) * _per_axis(noise.gyro_bias_std, noise.accelerometer_bias_std)
    return np.asarray(np.cumsum(steps, axis=0) + white)


def _per_axis(gyro: float, accelerometer: float) -> Floats:
    """Returns (6,) values: `gyro` for three axes, then `accelerometer` for three axes."""
    return np.repeat((gyro, accelerometer), 3)
