"""Models of lidars with one or several scan lines. Casts no rays."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from schemas.base import Positive
from schemas.rig.mount import MountedSensor
from schemas.rig.noise import LidarNoise

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
                found = f"{low} {getattr(self, low):g} must be less than {high} {getattr(self, high):g}"
                raise ValueError(f"{found}: swap them")
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
