"""Converts an episode to messages of ROS 2: topics, coordinate frames (REP 105, 103) and values.

Coordinate frames: map -> odom -> base_link -> front_camera_link -> front_camera_optical_frame. `map` is the world frame
of the scene; `odom` is equal to it, because odometry is exact.

Pure functions. Does not encode messages.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from factory.dataset.episode import Episode
from factory.export.mcap.messages import TopicMessage, calibration, paths_of, pose_of
from factory.export.mcap.sensor_frames import links_of, odometry_links
from factory.export.rig.description import OPTICAL_QUATERNION, mount_row
from factory.export.rig.reader import shown_pinhole, shown_rig
from factory.export.source import instances_json
from schemas.rig import PinholeCamera
from schemas.scene import CompiledScene, Instance, Target

MAP, ODOM, BASE = "map", "odom", "base_link"
CAMERA, OPTICAL = "front_camera_link", "front_camera_optical_frame"
_NANOSECONDS = 1_000_000_000
_OCCUPIED, _FREE = 100, 0
_CUBE, _TEXT = 1, 9
_RED, _WHITE = {"r": 1.0, "g": 0.16, "b": 0.16, "a": 0.35}, {"r": 1.0, "g": 1.0, "b": 1.0, "a": 1.0}
_UPRIGHT = {"w": 1.0}

ROS2_TOPICS: Mapping[str, str] = MappingProxyType(
    {
        "/camera/rgb/image_raw/compressed": "sensor_msgs/msg/CompressedImage",
        "/camera/rgb/camera_info": "sensor_msgs/msg/CameraInfo",
        "/camera/depth/image_raw": "sensor_msgs/msg/Image",
        "/camera/depth/camera_info": "sensor_msgs/msg/CameraInfo",
        "/camera/ids/image_raw": "sensor_msgs/msg/Image",
        "/ids/label_info": "vision_msgs/msg/LabelInfo",
        "/ids/instances": "std_msgs/msg/String",
        "/tf": "tf2_msgs/msg/TFMessage",
        "/tf_static": "tf2_msgs/msg/TFMessage",
        "/odom": "nav_msgs/msg/Odometry",
        "/cmd_vel": "geometry_msgs/msg/Twist",
        "/action_tokens": "std_msgs/msg/UInt8MultiArray",
        "/instruction": "std_msgs/msg/String",
        "/target": "visualization_msgs/msg/MarkerArray",
        "/map": "nav_msgs/msg/OccupancyGrid",
        "/path/driven": "nav_msgs/msg/Path",
        "/path/planned": "nav_msgs/msg/Path",
    }
)
"""Topic -> message type; `/path/planned` exists for experts that plan."""
LATCHED = frozenset({"/tf_static", "/instruction", "/target", "/map", "/path/driven", "/path/planned"}) | {
    "/ids/label_info",
    "/ids/instances",
}
"""Topics that are published once, with transient-local durability."""


def static_messages(episode: Episode, scene: CompiledScene, stamp_ns: int) -> Iterator[TopicMessage]:
    """Yields the messages that are published once, at frame 0.

    Args:
        episode: the episode.
        scene: scene of the episode.
        stamp_ns: time of frame 0, nanoseconds.
    """
    job = episode.meta.job
    yield TopicMessage("/tf_static", {"transforms": list(_static_transforms(episode, stamp_ns))})
    yield TopicMessage("/instruction", {"data": episode.meta.instruction})
    yield TopicMessage("/target", {"markers": _markers(scene.info.target(job.target_id), stamp_ns)})
    yield TopicMessage("/map", _map(scene, stamp_ns))
    yield from _label_messages(episode.instances, stamp_ns)
    header = header_of(MAP, stamp_ns)
    for topic, poses in paths_of(episode, scene):
        yield TopicMessage(topic, {"header": header, "poses": [{"header": header, "pose": pose} for pose in poses]})


def frame_messages(
    episode: Episode, t: int, stamp_ns: int, twist: NDArray[np.float64], with_images: bool
) -> Iterator[TopicMessage]:
    """Yields the transforms, odometry and command of a frame, and its images with their calibration.

    Args:
        episode: the episode.
        t: index of the frame.
        stamp_ns: time of the frame, nanoseconds.
        twist: (2,) measured v (m/s) and w (rad/s).
        with_images: whether to yield the images: RGB as PNG, depth in metres (+Inf without a hit, REP 117), ids.
    """
    action, body = episode.actions[t], pose_of(episode.poses[t].tolist())
    yield TopicMessage("/tf", {"transforms": [_transform(ODOM, BASE, body, stamp_ns)]})
    moving = {"linear": {"x": float(twist[0])}, "angular": {"z": float(twist[1])}}
    header = header_of(ODOM, stamp_ns)
    yield TopicMessage(
        "/odom", {"header": header, "child_frame_id": BASE, "pose": {"pose": body}, "twist": {"twist": moving}}
    )
    yield TopicMessage("/cmd_vel", {"linear": {"x": float(action[0])}, "angular": {"z": float(action[1])}})
    yield TopicMessage("/action_tokens", {"data": episode.tokens[t].astype(np.uint8)})
    if with_images:
        yield from _image_messages(episode, t, header_of(OPTICAL, stamp_ns))


def _label_messages(instances: Sequence[Instance], stamp_ns: int) -> Iterator[TopicMessage]:
    """Yields the labels of the ids in images and point clouds: the class of each id, and all that is known of it.

    The class of an instance without a category, such as a wall, is the last part of its path.
    """
    classes = [
        {"class_id": each.id, "class_name": each.category or each.prim_path.rpartition("/")[2]} for each in instances
    ]
    yield TopicMessage("/ids/label_info", {"header": header_of("", stamp_ns), "class_map": classes})
    yield TopicMessage("/ids/instances", {"data": instances_json(instances)})


def _image_messages(episode: Episode, t: int, header: dict[str, Any]) -> Iterator[TopicMessage]:
    info = _camera_info(shown_pinhole(episode), header)
    png, depth = episode.stored(f"rgb_front/{t:06d}.png"), episode.depth(t)
    colour = {"header": header, "format": "rgb8; png compressed bgr8", "data": png}
    yield TopicMessage("/camera/rgb/image_raw/compressed", colour)
    yield TopicMessage("/camera/rgb/camera_info", info)
    metres = np.where(depth > 0, depth, np.float32(np.inf)).astype("<f4")
    yield TopicMessage("/camera/depth/image_raw", image_of(header, "32FC1", metres))
    yield TopicMessage("/camera/depth/camera_info", info)
    yield TopicMessage("/camera/ids/image_raw", image_of(header, "mono16", episode.ids(t).astype("<u2")))


def header_of(frame: str, stamp_ns: int) -> dict[str, Any]:
    """Returns a std_msgs/Header."""
    stamp = {"sec": stamp_ns // _NANOSECONDS, "nanosec": stamp_ns % _NANOSECONDS}
    return {"stamp": stamp, "frame_id": frame}


def _transform(parent: str, child: str, pose: dict[str, dict[str, float]], stamp_ns: int) -> dict[str, Any]:
    moved = {"translation": pose["position"], "rotation": pose["orientation"]}
    return {"header": header_of(parent, stamp_ns), "child_frame_id": child, "transform": moved}


def _static_transforms(episode: Episode, stamp_ns: int) -> Iterator[dict[str, Any]]:
    yield _transform(MAP, ODOM, pose_of((0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)), stamp_ns)
    if (rig := episode.rig) is not None:
        for link in (*links_of(shown_rig(episode), BASE), *odometry_links(rig, ODOM, episode.poses[0].tolist())):
            yield _transform(link.parent, link.child, pose_of(link.pose), stamp_ns)
        return
    yield _transform(BASE, CAMERA, pose_of(mount_row(shown_pinhole(episode).mount)), stamp_ns)
    yield _transform(CAMERA, OPTICAL, pose_of((0.0, 0.0, 0.0, *OPTICAL_QUATERNION)), stamp_ns)


def _camera_info(camera: PinholeCamera, header: dict[str, Any]) -> dict[str, Any]:
    pinhole = calibration(camera)
    return {
        "header": header,
        "height": pinhole["height"],
        "width": pinhole["width"],
        "distortion_model": "plumb_bob",
        "d": [0.0] * 5,
        "k": pinhole["K"],
        "r": pinhole["R"],
        "p": pinhole["P"],
    }


def image_of(header: dict[str, Any], encoding: str, image: NDArray[Any]) -> dict[str, Any]:
    """Returns a sensor_msgs/Image of an array (H, W) or (H, W, C), little-endian."""
    height, width = image.shape[:2]
    step = image.nbytes // height
    data = image.tobytes()
    return {"header": header, "height": height, "width": width, "encoding": encoding, "step": step, "data": data}


def _map(scene: CompiledScene, stamp_ns: int) -> dict[str, Any]:
    info = scene.info
    rows, columns = scene.occupancy.shape
    x, y = info.grid_origin_m
    origin = pose_of((x, y, info.floor_height_m, 1.0, 0.0, 0.0, 0.0))
    size = {"resolution": info.grid_resolution_m, "width": columns, "height": rows, "origin": origin}
    data = np.where(scene.occupancy > 0, _OCCUPIED, _FREE).astype(np.int8).reshape(-1)
    return {"header": header_of(MAP, stamp_ns), "info": size, "data": data}


def _markers(target: Target, stamp_ns: int) -> list[dict[str, Any]]:
    x, y, z = target.centroid_m
    width, depth, height = target.size_m
    header = header_of(MAP, stamp_ns)
    box = {
        "type": _CUBE,
        "pose": {"position": {"x": x, "y": y, "z": z}, "orientation": _UPRIGHT},
        "scale": {"x": width, "y": depth, "z": height},
        "color": _RED,
    }
    text = {
        "type": _TEXT,
        "pose": {"position": {"x": x, "y": y, "z": z + height / 2 + 0.2}, "orientation": _UPRIGHT},
        "scale": {"z": 0.2},
        "color": _WHITE,
        "text": target.target_id,
    }
    return [{"header": header, "ns": "target", "id": number, **marker} for number, marker in enumerate((box, text))]
