"""The two kinds of MCAP file: Foxglove's messages in Protobuf, or those of ROS 2 in CDR. Knows no file."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from factory.dataset.episode import Episode
from factory.export.mcap import messages as foxglove
from factory.export.mcap import ros2_messages as ros2
from factory.export.mcap.messages import Said
from factory.export.mcap.protobuf import descriptor_set
from factory.export.mcap.protobuf import encode as encode_protobuf
from factory.export.mcap.ros2_cdr import definition_of
from factory.export.mcap.ros2_cdr import encode as encode_cdr
from schemas.scene import CompiledScene

__all__ = ["FOXGLOVE", "ROS2", "Profile"]

_KEPT = """\
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
"""Quality of service of a latched topic as rosbag2 records it: reliable, transient local, the last message."""


@dataclass(frozen=True)
class Profile:
    """How a kind of file is written."""

    name: str
    """Of the file's header; readers of ROS 2 demand `ros2`."""
    schema_encoding: str
    message_encoding: str
    topics: Mapping[str, str]
    """Topic -> name of the message."""
    schema_of: Callable[[str], bytes]
    """Message -> what its schema record holds."""
    encode: Callable[[str, Mapping[str, Any]], bytes]
    """Message and values -> bytes."""
    still: Callable[[Episode, CompiledScene, int], Iterator[Said]]
    """Episode, scene and time of frame 0 in nanoseconds -> messages that stand from the first frame on."""
    at: Callable[[Episode, int, int, NDArray[np.float64], bool], Iterator[Said]]
    """Episode, frame, its time, (2,) measured twist and whether to show images -> messages of the frame."""
    facts_of_topic: Callable[[str], dict[str, str]] = lambda _topic: {}
    """Topic -> metadata of its channel."""


def _foxglove_still(episode: Episode, scene: CompiledScene, _stamp_ns: int) -> Iterator[Said]:
    return foxglove.say_still(episode.meta, episode.poses, scene)


def _foxglove_at(
    episode: Episode, t: int, stamp_ns: int, twist: NDArray[np.float64], with_images: bool
) -> Iterator[Said]:
    camera = episode.meta.job.camera
    yield from foxglove.say_motion(t, camera, stamp_ns, episode.poses[t], twist, episode.actions[t], episode.tokens[t])
    if with_images:
        yield foxglove.say_rgb(stamp_ns, episode.stored(f"rgb_front/{t:06d}.png"))
        yield foxglove.say_depth(stamp_ns, episode.depth(t))
        yield foxglove.say_ids(stamp_ns, episode.ids(t))


def _ros2_still(episode: Episode, scene: CompiledScene, stamp_ns: int) -> Iterator[Said]:
    return ros2.say_still(episode.meta, episode.poses, scene, stamp_ns)


def _ros2_at(episode: Episode, t: int, stamp_ns: int, twist: NDArray[np.float64], with_images: bool) -> Iterator[Said]:
    yield from ros2.say_motion(stamp_ns, episode.poses[t], twist, episode.actions[t], episode.tokens[t])
    if with_images:
        png = episode.stored(f"rgb_front/{t:06d}.png")
        yield from ros2.say_images(stamp_ns, episode.meta.job.camera, png, episode.depth(t), episode.ids(t))


FOXGLOVE = Profile(
    name="",
    schema_encoding="protobuf",
    message_encoding="protobuf",
    topics=foxglove.TOPICS,
    schema_of=descriptor_set,
    encode=encode_protobuf,
    still=_foxglove_still,
    at=_foxglove_at,
)
ROS2 = Profile(
    name="ros2",
    schema_encoding="ros2msg",
    message_encoding="cdr",
    topics=ros2.ROS2_TOPICS,
    schema_of=definition_of,
    encode=encode_cdr,
    still=_ros2_still,
    at=_ros2_at,
    facts_of_topic=lambda topic: {"offered_qos_profiles": _KEPT if topic in ros2.LATCHED else ""},
)
