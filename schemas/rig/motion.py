"""Models of the sensors of motion: IMU and wheel odometry. Computes no measurements."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from schemas.base import Positive
from schemas.rig.mount import MountedSensor, TimedSensor
from schemas.rig.noise import ImuNoise, OdometryNoise


class Imu(MountedSensor):
    """Inertial measurement unit: angular velocity and specific force in the sensor frame."""

    model: Literal["imu"]
    """Sensor model."""
    gyro_range_rps: Positive = 34.9
    """Largest measured angular velocity of each axis, rad/s."""
    accelerometer_range_mps2: Positive = 156.9
    """Largest measured specific force of each axis, m/s2."""
    noise: ImuNoise | None = None
    """Noise; null is a perfect IMU."""


class WheelOdometry(TimedSensor):
    """Encoders of the two drive wheels and the pose that they give; it has no mounting pose."""

    model: Literal["odometry"]
    """Sensor model."""
    wheel_radius_m: Positive = 0.14
    """Radius of the drive wheels, metres."""
    track_m: Positive = 0.4132
    """Distance between the drive wheels, metres."""
    ticks_per_turn: Annotated[int, Field(ge=1, le=1 << 24)] = 4096
    """Encoder ticks per turn of a wheel."""
    noise: OdometryNoise | None = None
    """Slip and calibration errors; null is perfect odometry."""
