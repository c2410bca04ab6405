"""Converts an episode to messages of Foxglove: topics, coordinate frames and values. Pure functions.

Coordinate frames: `world` (REP 103, z up), `base_link`, `front_optical` (z forward, x right, y down). Times are
relative to the first recorded frame. Does not encode messages.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from factory.dataset.episode import Episode
from factory.export.mcap.sensor_frames import links_of, odometry_links
from factory.export.rig.description import intrinsics_of, optical_poses
from factory.export.rig.reader import shown_pinhole, shown_rig
from schemas.rig import PinholeCamera
from schemas.scene import CompiledScene, Target
from schemas.support.geometry import yaw_of

WORLD, BASE, OPTICAL = "world", "base_link", "front_optical"
_IN_BASE = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
_TARGET_COLOUR = {"r": 1.0, "g": 0.16, "b": 0.16, "a": 0.35}
_TEXT_COLOUR = {"r": 1.0, "g": 1.0, "b": 1.0, "a": 1.0}
_INFO = 2
_UINT8 = 1
_NANOSECONDS = 1_000_000_000

TOPICS: Mapping[str, str] = MappingProxyType(
    {
        "/camera/rgb": "foxglove.CompressedImage",
        "/camera/depth": "foxglove.RawImage",
        "/camera/ids": "foxglove.RawImage",
        "/camera/calibration": "foxglove.CameraCalibration",
        "/tf": "foxglove.FrameTransforms",
        "/odom": "foxglove.Odometry",
        "/action": "minivla.Action",
        "/instruction": "foxglove.Log",
        "/target": "foxglove.SceneUpdate",
        "/path/driven": "foxglove.PosesInFrame",
        "/path/planned": "foxglove.PosesInFrame",
        "/map": "foxglove.Grid",
    }
)
"""Topic -> message type; `/path/planned` exists for experts that plan."""


class TopicMessage(NamedTuple):
    """Message of a topic before it is encoded."""

    topic: str
    values: Mapping[str, Any]
    kind: str = ""
    """Message type; empty if the profile lists the topic with its type."""


def stamp_of(t: int, hz: int) -> int:
    """Returns the time of frame t since frame 0, nanoseconds."""
    return t * _NANOSECONDS // hz


def static_messages(episode: Episode, scene: CompiledScene, stamp_ns: int) -> Iterator[TopicMessage]:
    """Yields the messages that are published once, at frame 0: instruction, map, target, paths.

    Args:
        episode: the episode.
        scene: scene of the episode.
        stamp_ns: time of frame 0, nanoseconds.
    """
    meta, stamp = episode.meta, _timestamp(stamp_ns)
    yield TopicMessage(
        "/instruction", {"timestamp": stamp, "level": _INFO, "message": meta.instruction, "name": episode.episode_id}
    )
    yield TopicMessage("/map", _map_message(scene, stamp))
    yield TopicMessage("/target", {"entities": [_target_message(scene.info.target(meta.job.target_id), stamp)]})
    for topic, poses in paths_of(episode, scene):
        yield TopicMessage(topic, {"timestamp": stamp, "frame_id": WORLD, "poses": poses})


def frame_messages(
    episode: Episode, t: int, stamp_ns: int, twist: NDArray[np.float64], with_images: bool
) -> Iterator[TopicMessage]:
    """Yields the transforms, calibration, odometry and action of a frame, and its images.

    Args:
        episode: the episode; if it has a rig, the transforms are those of its sensors, and no calibration is written.
        t: index of the frame.
        stamp_ns: time of the frame, nanoseconds.
        twist: (2,) measured v (m/s) and w (rad/s).
        with_images: whether to yield the images: RGB as PNG, depth in metres as 32FC1 (0 without a hit), ids as 16UC1.
    """
    stamp = _timestamp(stamp_ns)
    action, tokens = episode.actions[t], episode.tokens[t]
    body = pose_of(episode.poses[t].tolist())
    yield TopicMessage("/tf", {"transforms": [_transform(BASE, WORLD, body, stamp), *_mounts(episode, stamp)]})
    if episode.rig is None:
        yield TopicMessage("/camera/calibration", {"timestamp": stamp, **calibration(shown_pinhole(episode))})
    v, w = (float(value) for value in twist)
    yield TopicMessage(
        "/odom",
        {
            "timestamp": stamp,
            "frame_id": WORLD,
            "body_frame_id": BASE,
            "pose": body,
            "linear_velocity": {"x": v},
            "angular_velocity": {"z": w},
            "metadata": [{"key": "frame", "value": str(t)}],
        },
    )
    yield TopicMessage(
        "/action",
        {
            "timestamp": stamp,
            "v_mps": float(action[0]),
            "w_rps": float(action[1]),
            "v_token": int(tokens[0]),
            "w_token": int(tokens[1]),
        },
    )
    if with_images:
        png = episode.stored(f"rgb_front/{t:06d}.png")
        yield TopicMessage("/camera/rgb", {"timestamp": stamp, "frame_id": OPTICAL, "data": png, "format": "png"})
        yield TopicMessage("/camera/depth", _raw_image(stamp, "32FC1", episode.depth(t).astype("<f4", copy=False)))
        yield TopicMessage("/camera/ids", _raw_image(stamp, "16UC1", episode.ids(t).astype("<u2", copy=False)))


def paths_of(episode: Episode, scene: CompiledScene) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """Yields the topic and the poses of the driven path and, for experts that plan, of the planned path."""
    yield "/path/driven", [pose_of(row) for row in episode.poses.tolist()]
    if planned := episode.meta.route.planned:
        z = scene.info.floor_height_m
        rows = [(x, y, z, math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)) for x, y, yaw in planned]
        yield "/path/planned", [pose_of(row) for row in rows]


def pose_of(row: Any) -> dict[str, dict[str, float]]:
    """Returns a pose message of x, y, z, qw, qx, qy, qz."""
    x, y, z, qw, qx, qy, qz = row
    return {"position": {"x": x, "y": y, "z": z}, "orientation": {"x": qx, "y": qy, "z": qz, "w": qw}}


def calibration(camera: PinholeCamera) -> dict[str, Any]:
    """Returns the pinhole model as foxglove.CameraCalibration, without a timestamp.

    In that message, as in ROS and OpenCV, the centre of the first pixel is at (0, 0). The coordinates of
    the image centre are therefore half the image size minus half a pixel.
    """
    intrinsics = intrinsics_of(camera)
    assert intrinsics is not None, "a pinhole camera has intrinsics"
    return {
        "frame_id": OPTICAL,
        "width": camera.width,
        "height": camera.height,
        "K": list(intrinsics.matrix),
        "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "P": list(intrinsics.projection),
    }


def measured_twists(poses: NDArray[np.float64], hz: int) -> NDArray[np.float64]:
    """Returns twists (T, 2), v along x (m/s) and yaw rate (rad/s), by backward differences of the poses.

    The first twist is zero, because the robot starts at rest.
    """
    yaw = yaw_of(poses)
    steps = np.diff(poses[:, :2], axis=0)
    forward = steps[:, 0] * np.cos(yaw[:-1]) + steps[:, 1] * np.sin(yaw[:-1])
    turned = np.angle(np.exp(1j * np.diff(yaw)))
    twists = np.zeros((len(poses), 2))
    twists[1:] = np.column_stack([forward, turned]) * hz
    return twists


def _timestamp(stamp_ns: int) -> dict[str, int]:
    return {"seconds": stamp_ns // _NANOSECONDS, "nanos": stamp_ns % _NANOSECONDS}


def _transform(child: str, parent: str, pose: dict[str, dict[str, float]], stamp: dict[str, int]) -> dict[str, Any]:
    return {
        "timestamp": stamp,
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": pose["position"],
        "rotation": pose["orientation"],
    }


def stamped(stamp_ns: int, frame: str) -> dict[str, Any]:
    """Returns the first fields of a message: time and coordinate frame."""
    return {"timestamp": _timestamp(stamp_ns), "frame_id": frame}


def _mounts(episode: Episode, stamp: dict[str, int]) -> Iterator[dict[str, Any]]:
    if episode.rig is None:
        optical = optical_poses(_IN_BASE, shown_pinhole(episode).mount)[0]
        yield _transform(OPTICAL, BASE, pose_of(optical.tolist()), stamp)
        return
    for link in (*links_of(shown_rig(episode), BASE), *odometry_links(episode.rig, WORLD, episode.poses[0].tolist())):
        yield _transform(link.child, link.parent, pose_of(link.pose), stamp)


def _raw_image(stamp: dict[str, int], encoding: str, image: NDArray[Any]) -> dict[str, Any]:
    height, width = image.shape
    return {
        "timestamp": stamp,
        "frame_id": OPTICAL,
        "width": width,
        "height": height,
        "encoding": encoding,
        "step": width * image.itemsize,
        "data": image.tobytes(),
    }


def _map_message(scene: CompiledScene, stamp: dict[str, int]) -> dict[str, Any]:
    info = scene.info
    columns = scene.occupancy.shape[1]
    x, y = info.grid_origin_m
    return {
        "timestamp": stamp,
        "frame_id": WORLD,
        "pose": pose_of((x, y, info.floor_height_m, 1.0, 0.0, 0.0, 0.0)),
        "column_count": columns,
        "cell_size": {"x": info.grid_resolution_m, "y": info.grid_resolution_m},
        "row_stride": columns,
        "cell_stride": 1,
        "fields": [{"name": "occupancy", "offset": 0, "type": _UINT8}],
        "data": scene.occupancy.tobytes(),
    }


def _target_message(target: Target, stamp: dict[str, int]) -> dict[str, Any]:
    x, y, z = target.centroid_m
    width, depth, height = target.size_m
    pose = pose_of((x, y, z, 1.0, 0.0, 0.0, 0.0))
    above = pose_of((x, y, z + height / 2 + 0.2, 1.0, 0.0, 0.0, 0.0))
    return {
        "timestamp": stamp,
        "frame_id": WORLD,
        "id": target.target_id,
        "cubes": [{"pose": pose, "size": {"x": width, "y": depth, "z": height}, "color": _TARGET_COLOUR}],
        "texts": [
            {
                "pose": above,
                "billboard": True,
                "font_size": 0.2,
                "color": _TEXT_COLOUR,
                "text": target.target_id,
            }
        ],
        "metadata": [
            {"key": "category", "value": target.category},
            {"key": "colour", "value": target.colour},
            {"key": "prim_path", "value": target.prim_path},
        ],
    }
