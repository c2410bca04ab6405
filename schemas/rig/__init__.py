"""Sensor rigs as data: cameras, lidars, IMUs, odometry, mounting poses, rates and noise, and their measurements."""

from schemas.rig.cameras import Camera, CameraOutput, DepthKind, EquirectangularCamera, FisheyeCamera, PinholeCamera
from schemas.rig.motion import Imu, WheelOdometry
from schemas.rig.mount import Mount
from schemas.rig.ranging import Lidar2d, Lidar3d
from schemas.rig.rig import Rig, Sensor

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
