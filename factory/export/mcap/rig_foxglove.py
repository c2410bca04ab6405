"""Converts the measurements of a rig to messages of Foxglove. Pure functions. Does not encode messages.

Foxglove has no message type for an IMU; `minivla.Imu` is used for its values.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from factory.export.mcap.messages import BASE, TopicMessage, pose_of, stamped
from factory.export.mcap.protobuf import IMU
from factory.export.mcap.sensor_frames import POINT, fields_of, frame_of, packed_points, planar_row
from factory.export.rig.description import intrinsics_of
from factory.export.rig.reader import Array, SensorReader
from schemas.encoding.png import encode_png
from schemas.rig import Camera, CameraOutput, Imu, Lidar2d, Lidar3d, Sensor, WheelOdometry
from workers.sensors import ImuMeasurements, OdometryMeasurements
from workers.sensors.lidar import ray_azimuths

_TYPES = {"<f4": 7, "<u2": 3}
"""NumPy type -> number of the type in foxglove.PackedElementField."""
_ENCODINGS = {"depth": "32FC1", "ids": "16UC1", "normals": "32FC3", "flow": "32FC2"}
_ORIGIN = pose_of((0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))


def sensor_messages(reader: SensorReader, sensor: Sensor, t: int, stamp_ns: int) -> Iterator[TopicMessage]:
    """Yields the messages of the measurement of a sensor at step t.

    Args:
        reader: sensors of the episode.
        sensor: sensor that measures at step t.
        t: control step.
        stamp_ns: time of the step, nanoseconds.
    """
    head = stamped(stamp_ns, frame_of(sensor))
    match sensor:
        case Imu() | WheelOdometry():
            yield _motion_message(sensor, reader.motion[sensor.name], t // reader.strides[sensor.name], head)
        case Lidar2d():
            yield _scan_message(sensor, reader.arrays(sensor, t)["ranges"], head)
        case Lidar3d():
            yield _cloud_message(sensor, reader, t, head)
        case _:
            yield from _camera_messages(reader.shown[sensor.name], reader.arrays(sensor, t), head)


def _camera_messages(camera: Camera, images: dict[str, Array], head: dict[str, Any]) -> Iterator[TopicMessage]:
    for output, image in images.items():
        topic = f"/{camera.name}/{output}"
        if output == CameraOutput.RGB:
            yield TopicMessage(topic, {**head, "data": encode_png(image), "format": "png"}, "foxglove.CompressedImage")
            continue
        data = image.astype(image.dtype.newbyteorder("<"), copy=False).tobytes()
        size = {"width": camera.width, "height": camera.height, "step": len(data) // camera.height}
        yield TopicMessage(topic, {**head, **size, "encoding": _ENCODINGS[output], "data": data}, "foxglove.RawImage")
    if (intrinsics := intrinsics_of(camera)) is not None:
        values = {
            "width": camera.width,
            "height": camera.height,
            "distortion_model": "kannala_brandt" if intrinsics.is_fisheye else "plumb_bob",
            "D": intrinsics.distortion,
            "K": intrinsics.matrix,
            "R": np.eye(3).ravel().tolist(),
            "P": intrinsics.projection,
        }
        yield TopicMessage(f"/{camera.name}/calibration", head | values, "foxglove.CameraCalibration")


def _scan_message(lidar: Lidar2d, ranges: Array, head: dict[str, Any]) -> TopicMessage:
    azimuths = ray_azimuths(lidar)
    values = {
        "pose": _ORIGIN,
        "start_angle": float(azimuths[0]),
        "end_angle": float(azimuths[-1]),
        "ranges": np.where(ranges > 0, ranges, np.inf)[0].tolist(),
    }
    return TopicMessage(f"/{lidar.name}/scan", head | values, "foxglove.LaserScan")


def _cloud_message(lidar: Lidar3d, reader: SensorReader, t: int, head: dict[str, Any]) -> TopicMessage:
    fields = [{"name": name, "offset": offset, "type": kind} for name, offset, kind in fields_of(_TYPES)]
    data = packed_points(reader.scan(lidar, t), lidar).tobytes()
    values = {"pose": _ORIGIN, "point_stride": POINT.itemsize, "fields": fields, "data": data}
    return TopicMessage(f"/{lidar.name}/points", head | values, "foxglove.PointCloud")


def _motion_message(
    sensor: Sensor, motion: ImuMeasurements | OdometryMeasurements, number: int, head: dict[str, Any]
) -> TopicMessage:
    if isinstance(motion, ImuMeasurements):
        names = "angular_velocity", "linear_acceleration"
        parts = motion.angular_velocity[number].tolist(), motion.specific_force[number].tolist()
        values: dict[str, Any] = {
            name: dict(zip("xyz", part, strict=True)) for name, part in zip(names, parts, strict=True)
        }
        return TopicMessage(f"/{sensor.name}/imu", head | values, IMU)
    (v, w), ticks = motion.twists[number].tolist(), motion.ticks[number].tolist()
    values = {
        "body_frame_id": BASE,
        "pose": pose_of(planar_row(motion.poses[number])),
        "linear_velocity": {"x": v},
        "angular_velocity": {"z": w},
        "metadata": [
            {"key": f"{side}_ticks", "value": str(count)} for side, count in zip(("left", "right"), ticks, strict=True)
        ],
    }
    return TopicMessage(f"/{sensor.name}/odom", head | values, "foxglove.Odometry")
