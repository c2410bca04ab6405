"""Converts the measurements of a rig to messages of ROS 2. Pure functions. Does not encode messages."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from factory.export.mcap.messages import TopicMessage, pose_of
from factory.export.mcap.ros2_messages import BASE, header_of, image_of
from factory.export.mcap.sensor_frames import POINT, fields_of, frame_of, packed_points, planar_row
from factory.export.rig.description import intrinsics_of
from factory.export.rig.reader import Array, SensorReader
from schemas.encoding.png import encode_png
from schemas.rig import Camera, CameraOutput, Imu, Lidar2d, Lidar3d, Sensor, WheelOdometry
from workers.sensors import ImuMeasurements, OdometryMeasurements
from workers.sensors.lidar import ray_azimuths

_TYPES = {"<f4": 7, "<u2": 4}
"""NumPy type -> number of the type in sensor_msgs/PointField."""
_ENCODINGS = {"depth": "32FC1", "ids": "mono16", "normals": "32FC3", "flow": "32FC2"}
_NO_ORIENTATION = (-1.0, *(0.0,) * 8)
"""Covariance that means "no orientation" in sensor_msgs/Imu."""


def sensor_messages(reader: SensorReader, sensor: Sensor, t: int, stamp_ns: int) -> Iterator[TopicMessage]:
    """Yields the messages of the measurement of a sensor at step t.

    Args:
        reader: sensors of the episode.
        sensor: sensor that measures at step t.
        t: control step.
        stamp_ns: time of the step, nanoseconds.
    """
    head = header_of(frame_of(sensor), stamp_ns)
    match sensor:
        case Imu() | WheelOdometry():
            yield from _motion_messages(sensor, reader.motion[sensor.name], t // reader.strides[sensor.name], head)
        case Lidar2d():
            yield _scan_message(sensor, reader, t, stamp_ns)
        case Lidar3d():
            yield _cloud_message(sensor, reader, t, head)
        case _:
            yield from _camera_messages(reader.shown[sensor.name], reader.arrays(sensor, t), head)


def _camera_messages(camera: Camera, images: dict[str, Array], head: dict[str, Any]) -> Iterator[TopicMessage]:
    info = _camera_info(camera, head)
    for output, image in images.items():
        place = f"/{camera.name}/{output}"
        if output == CameraOutput.RGB:
            values = {"header": head, "format": "rgb8; png compressed bgr8", "data": encode_png(image)}
            yield TopicMessage(f"{place}/image_raw/compressed", values, "sensor_msgs/msg/CompressedImage")
        else:
            shown = np.where(image > 0, image, np.float32(np.inf)) if output == CameraOutput.DEPTH else image
            values = image_of(head, _ENCODINGS[output], shown.astype(shown.dtype.newbyteorder("<"), copy=False))
            yield TopicMessage(f"{place}/image_raw", values, "sensor_msgs/msg/Image")
        if info is not None:
            yield TopicMessage(f"{place}/camera_info", info, "sensor_msgs/msg/CameraInfo")


def _camera_info(camera: Camera, head: dict[str, Any]) -> dict[str, Any] | None:
    intrinsics = intrinsics_of(camera)
    if intrinsics is None:
        return None
    return {
        "header": head,
        "height": camera.height,
        "width": camera.width,
        "distortion_model": "equidistant" if intrinsics.is_fisheye else "plumb_bob",
        "d": intrinsics.distortion,
        "k": intrinsics.matrix,
        "r": np.eye(3).ravel(),
        "p": intrinsics.projection,
    }


def _scan_message(lidar: Lidar2d, reader: SensorReader, t: int, stamp_ns: int) -> TopicMessage:
    """Returns the scan; its stamp is the time of the first ray, and `+Inf` means no return (REP 117)."""
    azimuths, ranges = ray_azimuths(lidar), reader.scan(lidar, t).ranges[0]
    increment = math.radians((lidar.azimuth_max_deg - lidar.azimuth_min_deg) / lidar.samples)
    step_s = (lidar.noise.sweep_s if lidar.noise else 0.0) / lidar.samples
    values = {
        "header": header_of(frame_of(lidar), stamp_ns - round(1e9 * step_s * (lidar.samples - 1))),
        "angle_min": float(azimuths[0]),
        "angle_max": float(azimuths[-1]),
        "angle_increment": increment,
        "time_increment": step_s,
        "scan_time": reader.strides[lidar.name] / reader.hz,
        "range_min": lidar.range_min_m,
        "range_max": lidar.range_max_m,
        "ranges": np.where(ranges > 0, ranges, np.float32(np.inf)),
    }
    return TopicMessage(f"/{lidar.name}/scan", values, "sensor_msgs/msg/LaserScan")


def _cloud_message(lidar: Lidar3d, reader: SensorReader, t: int, head: dict[str, Any]) -> TopicMessage:
    points = packed_points(reader.scan(lidar, t), lidar)
    values = {
        "header": head,
        "height": 1,
        "width": len(points),
        "fields": [
            {"name": name, "offset": offset, "datatype": kind, "count": 1} for name, offset, kind in fields_of(_TYPES)
        ],
        "point_step": POINT.itemsize,
        "row_step": POINT.itemsize * len(points),
        "data": points.tobytes(),
        "is_dense": True,
    }
    return TopicMessage(f"/{lidar.name}/points", values, "sensor_msgs/msg/PointCloud2")


def _motion_messages(
    sensor: Sensor, motion: ImuMeasurements | OdometryMeasurements, number: int, head: dict[str, Any]
) -> Iterator[TopicMessage]:
    if isinstance(motion, ImuMeasurements):
        names = "angular_velocity", "linear_acceleration"
        parts = motion.angular_velocity[number].tolist(), motion.specific_force[number].tolist()
        values: dict[str, Any] = {
            name: dict(zip("xyz", part, strict=True)) for name, part in zip(names, parts, strict=True)
        }
        values |= {"header": head, "orientation": {"w": 1.0}, "orientation_covariance": _NO_ORIENTATION}
        yield TopicMessage(f"/{sensor.name}/imu", values, "sensor_msgs/msg/Imu")
        return
    v, w = motion.twists[number].tolist()
    values = {
        "header": head,
        "child_frame_id": BASE,
        "pose": {"pose": pose_of(planar_row(motion.poses[number]))},
        "twist": {"twist": {"linear": {"x": v}, "angular": {"z": w}}},
    }
    yield TopicMessage(f"/{sensor.name}/odom", values, "nav_msgs/msg/Odometry")
    yield TopicMessage(f"/{sensor.name}/ticks", {"data": motion.ticks[number]}, "std_msgs/msg/Int64MultiArray")
