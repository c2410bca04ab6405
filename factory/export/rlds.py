"""Converts an episode to RLDS steps (OpenVLA, Octo, Open X-Embodiment). Reads the episode only.

Does not write files: TFDS writes them in an environment with TensorFlow; the builder is in `docs/formats/rlds`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from factory.dataset.episode import Episode
from factory.export.lerobot.columns import frame_columns, kept_frames
from factory.export.options import stride_of
from factory.export.origin import origin_of
from factory.export.rig.description import optical_poses
from factory.export.rig.reader import shown_pinhole

_BASE = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
"""Pose of base_link in itself."""


class RldsObservation(TypedDict):
    """Observation of a step."""

    image: NDArray[np.uint8]
    """(image_px, image_px, 3) sRGB."""
    depth: NDArray[np.float32]
    """(image_px, image_px, 1) depth along the optical axis, metres; 0 without a hit; nearest-neighbour resampling."""
    state: NDArray[np.float32]
    """(5,) wheel odometry: x, y, yaw in the frame of the first pose (m, rad), v and w (m/s, rad/s)."""


class Step(TypedDict):
    """RLDS step."""

    observation: RldsObservation
    action: NDArray[np.float32]
    """(2,) mean command until the next step: v (m/s), w (rad/s)."""
    action_tokens: NDArray[np.int32]
    """(2,) tokens of the action on the 7 x 7 grid."""
    discount: float
    reward: float
    """1 at the last step, else 0; every archived episode is successful."""
    is_first: bool
    is_last: bool
    is_terminal: bool
    language_instruction: str
    camera_pose: NDArray[np.float32]
    """(7,) x, y, z, qw, qx, qy, qz of the optical frame (x right, y down, z forward) in the world, metres."""


def rlds_steps(episode: Episode, fps: int | None = None, image_px: int = 256) -> Iterator[Step]:
    """Yields the steps of an episode, with one frame in memory at a time.

    Args:
        episode: episode to convert.
        fps: steps per second, a divisor of the recorded rate; `None` for all frames.
        image_px: side of the images, pixels; 640 is the recorded size.

    Raises:
        UsageError: the rate does not divide the recorded rate.
        ArchiveCorrupt: the episode is damaged.
    """
    hz = episode.meta.job.task.control_hz
    stride = stride_of(fps, hz)
    kept = kept_frames(len(episode), stride)
    columns = frame_columns(episode.actions, episode.poses, hz, stride)
    tokens = columns.tokens.astype(np.int32)
    cameras = optical_poses(episode.poses[np.asarray(kept)], shown_pinhole(episode).mount).astype(np.float32)
    for number, t in enumerate(kept):
        is_last = number == len(kept) - 1
        yield {
            "observation": {
                "image": _resize(episode.rgb(t), image_px),
                "depth": _nearest(episode.depth(t), image_px)[:, :, None],
                "state": columns.state[number],
            },
            "action": columns.action[number],
            "action_tokens": tokens[number],
            "discount": 1.0,
            "reward": float(is_last),
            "is_first": number == 0,
            "is_last": is_last,
            "is_terminal": is_last,
            "language_instruction": episode.instruction,
            "camera_pose": cameras[number],
        }


def rlds_metadata(episode: Episode, image_px: int = 256) -> dict[str, Any]:
    """Returns the metadata of an episode.

    Args:
        episode: episode to describe.
        image_px: side of the images, pixels, to which `camera_matrix` (3, 3) refers; the centre of the first pixel is
            (0, 0). `camera_in_base` is the pose of the optical frame in base_link: x, y, z, qw, qx, qy, qz.
    """
    row, camera = episode.summary, shown_pinhole(episode)
    (fx, fy), (cx, cy), scale = camera.focal_px, camera.centre_px, image_px / camera.width
    matrix = ((fx * scale, 0.0, cx * scale - 0.5), (0.0, fy * scale, cy * scale - 0.5), (0.0, 0.0, 1.0))
    return {
        "episode_id": row.episode_id,
        "split": str(row.split),
        "scene": row.scene,
        "target_category": row.target_category,
        "target_id": row.target_id,
        "template_id": row.template_id,
        "states_digest": episode.states_digest,
        "origin": origin_of(episode).to_json(),
        "camera_matrix": [list(row) for row in matrix],
        "camera_in_base": optical_poses(_BASE, camera.mount)[0].tolist(),
    }


def _resize(rgb: NDArray[np.uint8], side: int) -> NDArray[np.uint8]:
    if rgb.shape[0] == side:
        return rgb
    return np.asarray(Image.fromarray(rgb).resize((side, side), Image.Resampling.BOX))


def _nearest(depth: NDArray[np.float32], side: int) -> NDArray[np.float32]:
    chosen = ((np.arange(side) + 0.5) * depth.shape[0] / side).astype(int)
    picked: NDArray[np.float32] = depth[chosen[:, None], chosen[None, :]]
    return picked
