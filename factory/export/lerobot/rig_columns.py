"""Computes the columns of the sensors of a rig: odometry, IMU and scans, as they are known at each exported frame.

A row has the latest measurement at or before its frame, so no row depends on the future. Pure functions.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from factory.export.lerobot.layout import Layout
from factory.export.rig.reader import SensorReader
from schemas.rig import Lidar2d, Lidar3d
from workers.sensors import ImuMeasurements


def rig_columns(layout: Layout, reader: SensorReader, kept: Sequence[int]) -> dict[str, NDArray[np.float32]]:
    """Returns the values (N, ...) of the columns that a sensor of the rig measures.

    Args:
        layout: features of the export.
        reader: sensors of the episode.
        kept: control steps (N,) of the exported frames.
    """
    return {
        name: _scans(reader, column.sensor, kept)
        if isinstance(column.sensor, Lidar2d | Lidar3d)
        else _vectors(reader, column.sensor.name, kept)
        for name, column in layout.columns.items()
        if column.sensor is not None
    }


def _vectors(reader: SensorReader, name: str, kept: Sequence[int]) -> NDArray[np.float32]:
    """Returns (N, 6) angular velocity and specific force, or (N, 5) pose and twist of odometry."""
    motion = reader.motion[name]
    if isinstance(motion, ImuMeasurements):
        measured = np.concatenate((motion.angular_velocity, motion.specific_force), axis=1)
    else:
        measured = np.concatenate((motion.poses, motion.twists), axis=1).astype(np.float32)
    return np.asarray(measured[np.asarray(kept) // reader.strides[name]])


def _scans(reader: SensorReader, lidar: Lidar2d | Lidar3d, kept: Sequence[int]) -> NDArray[np.float32]:
    """Returns ranges (N, samples), or (N, lines, samples), metres; 0 without a return."""
    ranges = np.stack([reader.arrays(lidar, t)["ranges"] for t in kept])
    return ranges[:, 0] if isinstance(lidar, Lidar2d) else ranges
