"""Profiles of MCAP files: messages of Foxglove in Protobuf, or of ROS 2 in CDR. Does not write files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

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
from factory.export.rig.reader import SensorReader
from schemas.rig import Sensor
from schemas.scene import CompiledScene

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
    facts_of_topic=lambda topic: {"offered_qos_profiles": _LATCHED_QOS if topic in ros2.LATCHED else ""},
)
