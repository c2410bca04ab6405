"""Measurements of sensors from exact states and images without noise: lidar, IMU, wheel odometry, colour and depth.

Pure functions on arrays; noise depends on seed, episode, sensor and control step only. Reads no files and renders
nothing.
"""

from workers.sensors.images import colour_steps, sense_colour, sense_depth
from workers.sensors.imu import ImuMeasurements, sense_imu
from workers.sensors.lidar import LidarScan, points_of, sense_lidar
from workers.sensors.observation import CameraMeasurement
from workers.sensors.odometry import OdometryMeasurements, sense_odometry
from workers.sensors.streams import NoiseKey

__all__ = [
    "CameraMeasurement",
    "ImuMeasurements",
    "LidarScan",
    "NoiseKey",
    "OdometryMeasurements",
    "colour_steps",
    "points_of",
    "sense_colour",
    "sense_depth",
    "sense_imu",
    "sense_lidar",
    "sense_odometry",
]
