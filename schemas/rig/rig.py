"""The rig: sensors on a body. Checks that names differ, and that sensors are outside of the body and above the floor.

Does not read files; `schemas.rig.rig_file` does.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from typing import Annotated, Any, Self

from pydantic import Field, StringConstraints, model_validator

from schemas.base import Line, Model, Text
from schemas.errors import UsageError
from schemas.rig.cameras import EquirectangularCamera, FisheyeCamera, PinholeCamera
from schemas.rig.sensors import Imu, Lidar2d, Lidar3d, Mount, WheelOdometry
from schemas.support.suggest import did_you_mean

RigName = Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_-]{0,63}$")]
"""Name of a rig: lower-case letters, digits, underscore and hyphen."""
Sensor = Annotated[
    PinholeCamera | FisheyeCamera | EquirectangularCamera | Lidar2d | Lidar3d | Imu | WheelOdometry,
    Field(discriminator="model"),
]
"""Any sensor; `model` selects its type."""
_Coordinate = Annotated[float, Field(ge=-10, le=10)]
_Point = tuple[_Coordinate, _Coordinate, _Coordinate]


class Box(Model):
    """Box along the axes of base_link."""

    low_m: _Point
    """Corner with the smallest x, y and z in base_link, metres."""
    high_m: _Point
    """Corner with the largest x, y and z in base_link, metres."""

    @model_validator(mode="after")
    def _corners_are_ordered(self) -> Self:
        if any(low >= high for low, high in zip(self.low_m, self.high_m, strict=True)):
            raise ValueError(f"low_m {list(self.low_m)} must be less than high_m {list(self.high_m)} along each axis")
        return self

    def contains(self, mount: Mount) -> bool:
        """Returns whether the origin of a sensor frame is inside the box."""
        point = mount.x_m, mount.y_m, mount.z_m
        return all(low < value < high for low, value, high in zip(self.low_m, point, self.high_m, strict=True))


class Rig(Model):
    """Named sensors of a robot."""

    # data, because classes of users would run in the validator; not URDF, which has no noise and no distortion
    name: RigName
    """Name of the rig."""
    summary: Line = ""
    """Description in one line."""
    source: Text = ""
    """Sources of the poses and parameters."""
    body: Annotated[tuple[Box, ...], Field(max_length=64)] = ()
    """Solid parts of the robot, in which no camera and no lidar can be."""
    sensors: Annotated[tuple[Sensor, ...], Field(min_length=1, max_length=32)]
    """Sensors, in the order of their images in contact sheets and tables."""

    @property
    def cameras(self) -> tuple[PinholeCamera | FisheyeCamera | EquirectangularCamera, ...]:
        kinds = PinholeCamera | FisheyeCamera | EquirectangularCamera
        return tuple(sensor for sensor in self.sensors if isinstance(sensor, kinds))

    def plain(self) -> dict[str, Any]:
        """Returns the rig as JSON values; omits values that equal their default."""
        return self.model_dump(mode="json", exclude_defaults=True)

    @property
    def digest(self) -> str:
        """SHA-256 of the canonical JSON of the rig."""
        text = json.dumps(self.plain(), sort_keys=True, separators=(",", ":"), ensure_ascii=False)
        return hashlib.sha256(text.encode()).hexdigest()

    def choose(self, names: Iterable[str] | None = None) -> dict[str, Sensor]:
        """Returns the sensors with the given names; `None` returns all sensors.

        Raises:
            UsageError: the rig has no sensor of that name.
        """
        known = {sensor.name: sensor for sensor in self.sensors}
        chosen = list(known if names is None else names)
        for name in chosen:
            if name not in known:
                raise UsageError(
                    f"rig {self.name!r} has no sensor {name!r}; its sensors: {', '.join(known)}"
                    f"{did_you_mean(name, known)}"
                )
        return {name: known[name] for name in chosen}

    def faults(self, control_hz: int) -> list[str]:
        """Returns a message for each sensor whose rate does not divide a control rate."""
        findings = []
        for sensor in self.sensors:
            try:
                sensor.stride(control_hz)
            except ValueError as error:
                findings.append(str(error))
        return findings

    @model_validator(mode="after")
    def _sensors_fit(self) -> Self:
        names = [sensor.name for sensor in self.sensors]
        twice = sorted({name for name in names if names.count(name) > 1})
        faults = [f"two sensors are named {name!r}: rename one" for name in twice]
        faults += [fault for sensor in self.sensors for fault in _misplaced(sensor, self.body)]
        if faults:
            raise ValueError("\n".join(faults))
        return self


def _misplaced(sensor: Sensor, body: tuple[Box, ...]) -> list[str]:
    """Returns messages for a sensor below the floor, or a camera or lidar inside the robot."""
    if isinstance(sensor, WheelOdometry):
        return []
    mount = sensor.mount
    where = f"sensor {sensor.name!r} at ({mount.x_m:g}, {mount.y_m:g}, {mount.z_m:g}) m"
    if mount.z_m <= 0:
        return [f"{where} is not above the floor: increase mount.z_m"]
    boxes = () if isinstance(sensor, Imu) else body
    return [
        f"{where} is inside the robot, x {box.low_m[0]:g} to {box.high_m[0]:g}, y {box.low_m[1]:g} to "
        f"{box.high_m[1]:g}, z {box.low_m[2]:g} to {box.high_m[2]:g} m: move it outside, or correct body"
        for box in boxes
        if box.contains(mount)
    ][:1]
