"""Converts an episode to messages of Foxglove: topics, frames and values. Pure. Does not encode messages.

Frames: `world` (REP 103, z up), `base_link`, `front_optical` (z forward, x right, y down). Times count from frame 0.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.config import CameraConfig
from schemas.encoding.arrays import FRAME_SIZE_PX
from schemas.episode import EpisodeMeta
from schemas.measure import yaw_of
from schemas.scene import CompiledScene, Target

__all__ = [
    "OPTICAL_FROM_BASE",
    "TOPICS",
    "TopicMessage",
    "calibration",
    "measured_twists",
    "motion_messages",
    "stamp_of",
    "static_messages",
]

WORLD, BASE, OPTICAL = "world", "base_link", "front_optical"
OPTICAL_FROM_BASE = (-0.5, 0.5, -0.5, 0.5)
"""Quaternion (x, y, z, w) of the optical frame in base_link: z forward, x right, y down."""
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


def stamp_of(t: int, hz: int) -> int:
    """Returns the time of frame t since frame 0, nanoseconds."""
    return t * _NANOSECONDS // hz


def static_messages(meta: EpisodeMeta, poses: NDArray[np.float64], scene: CompiledScene) -> Iterator[TopicMessage]:
    """Yields the messages that are published once, at frame 0: instruction, map, target, calibration, paths."""
    stamp = _timestamp(0)
    yield TopicMessage(
        "/instruction", {"timestamp": stamp, "level": _INFO, "message": meta.job.instruction, "name": meta.episode_id}
    )
    yield TopicMessage("/map", _map_message(scene, stamp))
    yield TopicMessage("/target", {"entities": [_target_message(scene.info.target(meta.job.target_id), stamp)]})
    yield TopicMessage(
        "/path/driven", {"timestamp": stamp, "frame_id": WORLD, "poses": [_pose(row) for row in poses.tolist()]}
    )
    if meta.route.planned:
        z = scene.info.floor_height_m
        planned = [_pose((x, y, z, math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))) for x, y, yaw in meta.route.planned]
        yield TopicMessage("/path/planned", {"timestamp": stamp, "frame_id": WORLD, "poses": planned})


def motion_messages(
    t: int,
    camera: CameraConfig,
    stamp_ns: int,
    pose: NDArray[np.float64],
    twist: NDArray[np.float64],
    action: NDArray[np.float32],
    tokens: NDArray[np.int16],
) -> Iterator[TopicMessage]:
    """Yields the transforms, odometry and action of frame t.

    Args:
        t: index of the frame.
        camera: camera with its mounting pose.
        stamp_ns: time since frame 0, nanoseconds.
        pose: (7,) x, y, z, qw, qx, qy, qz of base_link in the world frame.
        twist: (2,) measured v (m/s) and w (rad/s).
        action: (2,) commanded v (m/s) and w (rad/s).
        tokens: (2,) tokens of the action.
    """
    stamp = _timestamp(stamp_ns)
    body = _pose(pose.tolist())
    yield TopicMessage("/tf", {"transforms": [_transform(BASE, WORLD, body, stamp), _camera_transform(camera, stamp)]})
    yield TopicMessage("/camera/calibration", {"timestamp": stamp, **calibration(camera)})
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


def rgb_message(stamp_ns: int, png: bytes) -> TopicMessage:
    """Returns the message of an RGB frame, as PNG."""
    values = {"timestamp": _timestamp(stamp_ns), "frame_id": OPTICAL, "data": png, "format": "png"}
    return TopicMessage("/camera/rgb", values)


def depth_message(stamp_ns: int, depth: NDArray[np.float32]) -> TopicMessage:
    """Returns the message of a depth frame (H, W), metres along the optical axis, as 32FC1; 0 without a hit."""
    return TopicMessage("/camera/depth", _raw_image(stamp_ns, "32FC1", depth.astype("<f4", copy=False)))


def ids_message(stamp_ns: int, ids: NDArray[np.uint16]) -> TopicMessage:
    """Returns the message of an instance id frame (H, W), as 16UC1."""
    return TopicMessage("/camera/ids", _raw_image(stamp_ns, "16UC1", ids.astype("<u2", copy=False)))


def calibration(camera: CameraConfig) -> dict[str, Any]:
    """Returns the pinhole model as foxglove.CameraCalibration, without a timestamp.

    In that message, as in ROS and OpenCV, the centre of the first pixel is at (0, 0); this requires the half pixel.
    """
    focal = FRAME_SIZE_PX / 2 / math.tan(math.radians(camera.fov_deg) / 2)
    centre = FRAME_SIZE_PX / 2 - 0.5
    return {
        "frame_id": OPTICAL,
        "width": FRAME_SIZE_PX,
        "height": FRAME_SIZE_PX,
        "K": [focal, 0.0, centre, 0.0, focal, centre, 0.0, 0.0, 1.0],
        "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "P": [focal, 0.0, centre, 0.0, 0.0, focal, centre, 0.0, 0.0, 0.0, 1.0, 0.0],
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


def _pose(row: Any) -> dict[str, dict[str, float]]:
    x, y, z, qw, qx, qy, qz = row
    return {"position": {"x": x, "y": y, "z": z}, "orientation": {"x": qx, "y": qy, "z": qz, "w": qw}}


def _transform(child: str, parent: str, pose: dict[str, dict[str, float]], stamp: dict[str, int]) -> dict[str, Any]:
    return {
        "timestamp": stamp,
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": pose["position"],
        "rotation": pose["orientation"],
    }


def _camera_transform(camera: CameraConfig, stamp: dict[str, int]) -> dict[str, Any]:
    qx, qy, qz, qw = OPTICAL_FROM_BASE
    return _transform(OPTICAL, BASE, _pose((camera.x_m, camera.y_m, camera.z_m, qw, qx, qy, qz)), stamp)


def _raw_image(stamp_ns: int, encoding: str, image: NDArray[Any]) -> dict[str, Any]:
    height, width = image.shape
    return {
        "timestamp": _timestamp(stamp_ns),
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
        "pose": _pose((x, y, info.floor_height_m, 1.0, 0.0, 0.0, 0.0)),
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
    pose = _pose((x, y, z, 1.0, 0.0, 0.0, 0.0))
    above = _pose((x, y, z + height / 2 + 0.2, 1.0, 0.0, 0.0, 0.0))
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
