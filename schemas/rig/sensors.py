"""Models of a rig's sensors other than cameras: mounting pose, lidars, IMU and wheel odometry.

Computes no rotation, casts no rays and measures nothing.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from schemas.base import Model, Name, Positive
from schemas.rig.noise import ImuNoise, LidarNoise, OdometryNoise

_Coordinate = Annotated[float, Field(ge=-10, le=10)]
_Angle = Annotated[float, Field(ge=-180, le=180)]


class Mount(Model):
    """Pose of the sensor frame (x forward, y left, z up) in base_link, as the `origin` of a URDF joint.

    The rotation turns about the fixed axes x, y and z of base_link, in this order. A camera looks along x of its frame.
    """

    x_m: _Coordinate = 0.0
    """x in base_link, metres; at most 10 m from the origin, like y and z."""
    y_m: _Coordinate = 0.0
    """y in base_link, metres."""
    z_m: _Coordinate = 0.0
    """Height above the floor, metres."""
    roll_deg: _Angle = 0.0
    """Rotation about x, degrees."""
    pitch_deg: _Angle = 0.0
    """Rotation about y, degrees; positive values turn a camera down."""
    yaw_deg: _Angle = 0.0
    """Rotation about z, degrees; positive values turn a camera to the left."""


class TimedSensor(Model):
    """Fields of every sensor."""

    name: Name
    """Name of the sensor, unique in its rig."""
    rate_hz: Annotated[float, Field(gt=0, le=240)] | None = None
    """Measurements per second; the control rate must be a multiple of this number. Null is the control rate."""

    def stride(self, control_hz: int) -> int:
        """Returns the number of control steps between two measurements.

        Raises:
            ValueError: the rate does not divide the control rate.
        """
        steps = control_hz / (self.rate_hz or control_hz)
        if abs(steps - round(steps)) > 1e-6 or steps < 1 - 1e-6:
            divisors = [control_hz // count for count in range(1, control_hz + 1) if control_hz % count == 0]
            raise ValueError(
                f"sensor {self.name!r}: rate_hz {self.rate_hz:g} does not divide the control rate, {control_hz} Hz "
                f"(whole rates that do: {', '.join(map(str, divisors))})"
            )
        return round(steps)


class MountedSensor(TimedSensor):
    """Fields of every sensor with a mounting pose."""

    mount: Mount = Mount()
    """Mounting pose in base_link."""


MAX_RAYS = 1 << 20
"""Largest number of rays of a scan."""
_Azimuth = Annotated[float, Field(ge=-360, le=360)]


class _Lidar(MountedSensor):
    samples: Annotated[int, Field(ge=1, le=65_536)]
    """Rays per scan line, evenly spaced from the first azimuth; the last azimuth is excluded."""
    azimuth_min_deg: _Azimuth = -180.0
    """First azimuth, degrees, counter-clockwise from x of the sensor frame."""
    azimuth_max_deg: _Azimuth = 180.0
    """Azimuth at which the scan ends, degrees; excluded."""
    range_min_m: Positive
    """Shortest range with a measurement, metres."""
    range_max_m: Positive
    """Longest range with a measurement, metres."""
    noise: LidarNoise | None = None
    """Noise of the ranges; null is a perfect lidar."""

    @model_validator(mode="after")
    def _ranges_are_ordered(self) -> Self:
        for low, high in (("range_min_m", "range_max_m"), ("azimuth_min_deg", "azimuth_max_deg")):
            if getattr(self, low) >= getattr(self, high):
                problem = f"{low} {getattr(self, low):g} must be less than {high} {getattr(self, high):g}"
                raise ValueError(f"{problem}: swap them")
        if self.azimuth_max_deg - self.azimuth_min_deg > 360:
            raise ValueError("the azimuths span more than 360 degrees: reduce azimuth_max_deg")
        return self


class Lidar2d(_Lidar):
    """Lidar with one scan line in the x-y plane of its frame."""

    model: Literal["lidar2d"]
    """Sensor model."""


class Lidar3d(_Lidar):
    """Lidar with several scan lines."""

    model: Literal["lidar3d"]
    """Sensor model."""
    elevations_deg: Annotated[tuple[Annotated[float, Field(ge=-90, le=90)], ...], Field(min_length=1, max_length=256)]
    """Elevation of each scan line, degrees above the x-y plane of the sensor frame, from top to bottom."""

    @model_validator(mode="after")
    def _lines_are_ordered(self) -> Self:
        pairs = zip(self.elevations_deg, self.elevations_deg[1:], strict=False)
        if any(upper <= lower for upper, lower in pairs):
            raise ValueError("elevations_deg must decrease: list each scan line once, from top to bottom")
        rays = self.samples * len(self.elevations_deg)
        if rays > MAX_RAYS:
            raise ValueError(f"{rays} rays per scan are too many: reduce samples or scan lines to {MAX_RAYS} rays")
        return self


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
