"""Profiles of MCAP files: messages of Foxglove in Protobuf, or of ROS 2 in CDR; text of their cards and of bags."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from factory.dataset.episode import Episode
from factory.export.mcap import messages as foxglove
from factory.export.mcap import rig_foxglove, rig_ros2
from factory.export.mcap import ros2_messages as ros2
from factory.export.mcap.messages import TopicMessage
from factory.export.mcap.protobuf import descriptor_set
from factory.export.mcap.protobuf import encode as encode_protobuf
from factory.export.mcap.ros2_cdr import definition_of
from factory.export.mcap.ros2_cdr import encode as encode_cdr
from factory.export.rig.description import RIG_FILE, rig_table
from factory.export.rig.reader import SensorReader
from schemas.rig import Rig, Sensor
from schemas.scene import CompiledScene

_FOXGLOVE_CARD = """
One MCAP file per episode, `episodes/ep_000001.mcap`: chunked, compressed with zstd, indexed; times begin at frame 0.

| topic | schema |
|---|---|
{camera}\
| `/tf` | foxglove.FrameTransforms: world -> base_link{optical} |
| `/odom` | foxglove.Odometry: pose in the world, twist measured from the poses |
| `/action` | minivla.Action: commanded v_mps, w_rps and their tokens |
| `/instruction`, `/target`, `/map` | foxglove.Log, SceneUpdate, Grid; at frame 0 |
| `/path/driven`, `/path/planned` | foxglove.PosesInFrame; at frame 0 |
"""
_FOXGLOVE_CAMERA = """\
| `/camera/rgb` | foxglove.CompressedImage, PNG 640 x 640 |
| `/camera/depth` | foxglove.RawImage, 32FC1, metres along the optical axis, 0 where nothing was hit |
| `/camera/ids` | foxglove.RawImage, 16UC1, instance ids; the attachment `meta.json` names them |
| `/camera/calibration` | foxglove.CameraCalibration |
"""
_ROS2_CARD = """
One bag of rosbag2 per episode, `episodes/ep_000001/`: `metadata.yaml` and an MCAP file of profile `ros2` (CDR),
chunked, compressed with zstd, indexed; for `ros2 bag`, `rosbags` and Foxglove. Episode n starts {spacing} (n - 1) s
after {start} s since 1970.

| topic | message |
|---|---|
{camera}\
| `/tf`, `/tf_static` | map -> odom -> base_link{optical} |
| `/odom` | nav_msgs/Odometry: pose in odom, which is exact here, twist measured from the poses |
| `/cmd_vel` | geometry_msgs/Twist: the command |
| `/action_tokens` | std_msgs/UInt8MultiArray: the command on the 7 x 7 grid |
| `/instruction`, `/target`, `/map` | std_msgs/String, visualization_msgs/MarkerArray, nav_msgs/OccupancyGrid; once |
| `/path/driven`, `/path/planned` | nav_msgs/Path; once |
| `/ids/label_info` | vision_msgs/LabelInfo: the category of each instance id; once |
| `/ids/instances` | std_msgs/String: ids with paths, categories and materials as JSON; once |
"""


_ROS2_CAMERA = """\
| `/camera/rgb/image_raw/compressed` | sensor_msgs/CompressedImage, PNG 640 x 640 |
| `/camera/depth/image_raw` | sensor_msgs/Image, 32FC1, metres along the optical axis, +Inf where nothing was hit |
| `/camera/ids/image_raw` | sensor_msgs/Image, mono16, instance ids; `/ids/instances` names them |
| `/camera/rgb/camera_info`, `/camera/depth/camera_info` | sensor_msgs/CameraInfo |
"""
_FOXGLOVE_SENSORS = """\
| `/<camera>/rgb`, `depth`, `ids`, `normals`, `flow` | CompressedImage, PNG; RawImage: 32FC1, 16UC1, 32FC3, 32FC2 |
| `/<camera>/calibration` | foxglove.CameraCalibration: plumb_bob, or kannala_brandt of a fisheye; not of a panorama |
| `/<lidar>/scan`, `/<lidar>/points` | foxglove.LaserScan, +Inf without a return; PointCloud: x, y, z, ring, id |
| `/<imu>/imu` | minivla.Imu: angular velocity, specific force |
| `/<odometry>/odom` | foxglove.Odometry in the frame `<odometry>_start`, with encoder ticks |
"""
_ROS2_SENSORS = """\
| `/<camera>/rgb/image_raw/compressed` | sensor_msgs/CompressedImage, PNG |
| `/<camera>/depth/image_raw`, `ids`, `normals`, `flow` | sensor_msgs/Image: 32FC1, mono16, 32FC3, 32FC2 |
| `/<camera>/rgb/camera_info`, ... | sensor_msgs/CameraInfo: plumb_bob, or equidistant of a fisheye; not of a panorama |
| `/<lidar>/scan`, `/<lidar>/points` | sensor_msgs/LaserScan, +Inf without a return; PointCloud2: x, y, z, ring, id |
| `/<imu>/imu` | sensor_msgs/Imu without orientation |
| `/<odometry>/odom`, `/<odometry>/ticks` | nav_msgs/Odometry in frame `<odometry>_start`; std_msgs/Int64MultiArray |
"""
_FRAMES = """
Each sensor has the frame `<sensor>_link` (x forward, z up), and each camera `<camera>_optical_frame` (z forward).
"""


def foxglove_card(rig: Rig | None, control_hz: int) -> str:
    """Returns the text for messages of Foxglove."""
    if rig is None:
        return _FOXGLOVE_CARD.format(camera=_FOXGLOVE_CAMERA, optical=" -> front_optical")
    return _FOXGLOVE_CARD.format(camera=_FOXGLOVE_SENSORS, optical=" -> sensors") + _sensors(rig, control_hz)


def ros2_card(spacing_s: int, start_s: int, rig: Rig | None, control_hz: int) -> str:
    """Returns the text for messages of ROS 2.

    Args:
        spacing_s: interval between the starts of consecutive episodes, seconds.
        start_s: start of the first episode, seconds since 1970.
        rig: exported sensors; `None` for the recorded camera.
        control_hz: control rate, steps per second.
    """
    times = {"spacing": spacing_s, "start": start_s}
    if rig is None:
        optical = " -> front_camera_link -> front_camera_optical_frame"
        return _ROS2_CARD.format(camera=_ROS2_CAMERA, optical=optical, **times)
    return _ROS2_CARD.format(camera=_ROS2_SENSORS, optical=" -> sensors", **times) + _sensors(rig, control_hz)


def _sensors(rig: Rig, control_hz: int) -> str:
    return _FRAMES + rig_table(rig, control_hz, f"attachment {RIG_FILE}")


_LATCHED_QOS = """\
- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: 1
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false"""
"""Quality of service of a latched topic in the format of rosbag2: reliable, transient local, depth 1."""
_BAG = """\
rosbag2_bagfile_information:
  version: 5
  storage_identifier: mcap
  duration:
    nanoseconds: {duration}
  starting_time:
    nanoseconds_since_epoch: {start}
  message_count: {count}
  topics_with_message_count:
{topics}\
  compression_format: ""
  compression_mode: ""
  relative_file_paths:
    - {file}
  files:
    - path: {file}
      starting_time:
        nanoseconds_since_epoch: {start}
      duration:
        nanoseconds: {duration}
      message_count: {count}
"""
_BAG_TOPIC = """\
    - topic_metadata:
        name: {name}
        type: {kind}
        serialization_format: cdr
        offered_qos_profiles: {qos}
      message_count: {count}
"""
"""Parts of `metadata.yaml`. Version 5 is that of Humble; later distributions read it, but Humble does not read theirs.
`compression_format` is empty, because it means a compression outside of the MCAP file."""


class BagTopic(NamedTuple):
    """Topic of a bag."""

    name: str
    kind: str
    """Message type."""
    messages: int
    """Number of messages, at least 1."""


def bag_metadata(file: str, first_ns: int, last_ns: int, topics: Sequence[BagTopic]) -> str:
    """Returns `metadata.yaml` of a rosbag2 folder with one MCAP file.

    Args:
        file: name of the MCAP file.
        first_ns: time of the first message, nanoseconds.
        last_ns: time of the last message, nanoseconds.
        topics: topics of the file.
    """
    count = sum(topic.messages for topic in topics)
    return _BAG.format(
        file=file,
        start=first_ns,
        duration=last_ns - first_ns,
        count=count,
        topics="".join(
            _BAG_TOPIC.format(name=one.name, kind=one.kind, qos=json.dumps(qos_of(one.name)), count=one.messages)
            for one in topics
        ),
    )


def qos_of(topic: str) -> str:
    """Returns the quality of service of a topic as YAML; empty for the default of the player."""
    return _LATCHED_QOS if topic in ros2.LATCHED else ""


@dataclass(frozen=True)
class Profile:
    """Profile of an MCAP file: topics, schemas, encoding and messages."""

    name: str
    """Name of the profile in the header of the file; ROS 2 readers require `ros2`."""
    schema_encoding: str
    message_encoding: str
    topics: Mapping[str, str]
    """Topic -> message type."""
    schema_of: Callable[[str], bytes]
    """Message type -> data of its schema record."""
    encode: Callable[[str, Mapping[str, Any]], bytes]
    """Message type and values -> bytes."""
    static_messages: Callable[[Episode, CompiledScene, int], Iterator[TopicMessage]]
    """Episode, scene and time of frame 0 (nanoseconds) -> messages that are published once."""
    frame_messages: Callable[[Episode, int, int, NDArray[np.float64], bool], Iterator[TopicMessage]]
    """Episode, frame, its time (nanoseconds), measured twist (2,), whether to add images -> messages of the frame."""
    sensor_messages: Callable[[SensorReader, Sensor, int, int], Iterator[TopicMessage]]
    """Reader of an episode, sensor, step and time of its measurement (nanoseconds) -> messages of the measurement."""
    facts_of_topic: Callable[[str], dict[str, str]] = lambda _topic: {}
    """Topic -> metadata of its channel."""


FOXGLOVE = Profile(
    name="",
    schema_encoding="protobuf",
    message_encoding="protobuf",
    topics=foxglove.TOPICS,
    schema_of=descriptor_set,
    encode=encode_protobuf,
    static_messages=foxglove.static_messages,
    frame_messages=foxglove.frame_messages,
    sensor_messages=rig_foxglove.sensor_messages,
)
ROS2 = Profile(
    name="ros2",
    schema_encoding="ros2msg",
    message_encoding="cdr",
    topics=ros2.ROS2_TOPICS,
    schema_of=definition_of,
    encode=encode_cdr,
    static_messages=ros2.static_messages,
    frame_messages=ros2.frame_messages,
    sensor_messages=rig_ros2.sensor_messages,
    facts_of_topic=lambda topic: {"offered_qos_profiles": qos_of(topic)},
)
