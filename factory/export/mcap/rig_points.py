"""Packs a scan of a 3D lidar into the points of PointCloud messages. Pure functions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.rig import Lidar3d
from workers.sensors import LidarScan, points_of

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
