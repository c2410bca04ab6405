"""Mounting pose of a sensor, and the fields that every sensor has. Computes no rotation."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from schemas.base import Model, Name

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
