"""Sensor rigs as data: cameras, lidars, IMUs, odometry, mounting poses, rates and noise, and their measurements."""

from schemas.rig.cameras import Camera, CameraOutput, DepthKind, EquirectangularCamera, FisheyeCamera, PinholeCamera
from schemas.rig.rig import Rig, Sensor
from schemas.rig.sensors import Imu, Lidar2d, Lidar3d, Mount, WheelOdometry

__all__ = [
    "Camera",
    "CameraOutput",
    "DepthKind",
    "EquirectangularCamera",
    "FisheyeCamera",
    "Imu",
    "Lidar2d",
    "Lidar3d",
    "Mount",
    "PinholeCamera",
    "Rig",
    "Sensor",
    "WheelOdometry",
]
