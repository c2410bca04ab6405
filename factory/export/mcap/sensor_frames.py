"""Frames of a rig's sensors in MCAP files: names, transforms from base_link, points of scans. Pure functions.

A sensor has the frame `<name>_link` (x forward, y left, z up); a camera also has `<name>_optical_frame` (z forward, x
right, y down), which images refer to.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from factory.export.rig.description import OPTICAL_QUATERNION, mount_row
from schemas.errors import UsageError
from schemas.rig import Camera, Lidar3d, Rig, Sensor, WheelOdometry
from workers.sensors import LidarScan, points_of

_RESERVED = ("world", "map", "odom", "base_link")


class FrameLink(NamedTuple):
    """Constant transform between two coordinate frames."""

    parent: str
    child: str
    pose: tuple[float, ...]
    """x, y, z, qw, qx, qy, qz of the child in its parent."""


def frame_of(sensor: Sensor) -> str:
    """Returns the coordinate frame of a sensor's measurements; that of odometry is at the start pose of base_link."""
    if isinstance(sensor, WheelOdometry):
        return f"{sensor.name}_start"
    return f"{sensor.name}_optical_frame" if isinstance(sensor, Camera) else f"{sensor.name}_link"


def links_of(rig: Rig, base: str) -> Iterator[FrameLink]:
    """Yields the transforms from `base` to every frame of the rig, except those of odometry."""
    for sensor in rig.sensors:
        if isinstance(sensor, WheelOdometry):
            continue
        link = f"{sensor.name}_link"
        yield FrameLink(base, link, mount_row(sensor.mount))
        if isinstance(sensor, Camera):
            yield FrameLink(link, frame_of(sensor), (0.0, 0.0, 0.0, *OPTICAL_QUATERNION))


def planar_row(pose: NDArray[np.float64]) -> tuple[float, ...]:
    """Returns x, y, z, qw, qx, qy, qz of a pose x, y, heading."""
    x, y, heading = pose.tolist()
    return (x, y, 0.0, math.cos(heading / 2), 0.0, 0.0, math.sin(heading / 2))


def odometry_links(rig: Rig, world: str, start: tuple[float, ...]) -> Iterator[FrameLink]:
    """Yields the transform from the world to the frame of each odometry sensor: the start pose of base_link."""
    for sensor in rig.sensors:
        if isinstance(sensor, WheelOdometry):
            yield FrameLink(world, frame_of(sensor), start)


def require_different_frames(rig: Rig) -> None:
    """Checks that no two coordinate frames have the same name.

    Raises:
        UsageError: a frame of a sensor has the name of a frame of another sensor or of the robot.
    """
    seen = set(_RESERVED)
    for sensor in rig.sensors:
        names = {frame_of(sensor)} if isinstance(sensor, WheelOdometry) else {frame_of(sensor), f"{sensor.name}_link"}
        if twice := names & seen:
            raise UsageError(f"sensor {sensor.name!r}: the frame {min(twice)!r} exists already: rename the sensor")
        seen |= names


POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("ring", "<u2"), ("id", "<u2")])
"""Coordinates in the sensor frame (metres), index of the scan line (0 is the top line), instance id of the surface."""


def fields_of(types: Mapping[str, int]) -> list[tuple[str, int, int]]:
    """Returns name, offset in bytes and type number of each field of a point; `types` maps NumPy types to numbers."""
    fields: Mapping[str, Any] = POINT.fields or {}
    return [(name, fields[name][1], types[fields[name][0].str]) for name in POINT.names or ()]


def packed_points(scan: LidarScan, lidar: Lidar3d) -> NDArray[np.void]:
    """Returns the points (N,) that a scan hit, line by line, with dtype `POINT`."""
    has_return = scan.ranges > 0
    points = np.zeros(int(has_return.sum()), POINT)
    points["x"], points["y"], points["z"] = points_of(scan, lidar).T
    points["ring"], points["id"] = np.nonzero(has_return)[0], scan.ids[has_return]
    return points
