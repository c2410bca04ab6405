"""Optional packages that the sensors of a rig need. Imports none of them."""

from __future__ import annotations

from schemas.rig import Lidar2d, Lidar3d, Rig
from schemas.support.extras import require_package


def require_sensor_packages(rig: Rig | None) -> None:
    """Raises `UsageError` unless the packages that the sensors of a rig need are installed."""
    for sensor in rig.sensors if rig else ():
        if isinstance(sensor, Lidar2d | Lidar3d):
            require_package("embreex", f"the lidar {sensor.name!r}")
