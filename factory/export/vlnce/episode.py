"""One episode in the words of VLN-CE and Habitat: axes turned, path thinned, instruction as tokens. Pure.

Habitat's world is x right, y up, z backward (towards the viewer), and an agent looks along its own -z. Ours is x
forward, y left, z up (REP 103), and the robot looks along +x. One rotation takes a point over: (x, y, z) -> (x, z, -y).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.episode import EpisodeMeta
from schemas.measure import yaw_of

__all__ = [
    "PAD",
    "from_habitat",
    "rotation_of",
    "scene_file",
    "thin_track",
    "to_habitat",
    "tokens_of_text",
    "vlnce_episode",
    "vocabulary_of",
    "words_of",
]

PAD, UNKNOWN = "<pad>", "<unk>"
_WORD = re.compile(r"[a-z0-9]+|[^\sa-z0-9]")
_SPACING_M = 0.25
"""Distance between points of the reference path; VLN-CE's agents step so far."""

Vector = tuple[float, float, float]


def to_habitat(point: Sequence[float]) -> Vector:
    """Returns a point of our world frame in Habitat's: (x, y, z) -> (x, z, -y), metres."""
    x, y, z = (float(value) for value in point)
    return (x, z, -y + 0.0)


def from_habitat(point: Sequence[float]) -> Vector:
    """Returns a point of Habitat's world frame in ours; undoes `to_habitat`."""
    x, y, z = (float(value) for value in point)
    return (x, -z + 0.0, y)


def rotation_of(yaw_rad: float) -> tuple[float, float, float, float]:
    """Returns the quaternion (x, y, z, w) of a Habitat agent that looks along our heading `yaw_rad`.

    At heading 90 degrees, along our +y, the agent looks along Habitat's -z and its rotation is none.
    """
    half = (yaw_rad - math.pi / 2) / 2
    return (0.0, math.sin(half), 0.0, math.cos(half))


def thin_track(points: NDArray[np.float64], spacing_m: float = _SPACING_M) -> NDArray[np.float64]:
    """Returns the points of a (T, 3) track that lie at least `spacing_m` apart along it, first and last included."""
    steps = np.linalg.norm(np.diff(points[:, :2], axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    marks = np.arange(0.0, along[-1], spacing_m)
    chosen = [int(index) for index in np.searchsorted(along, marks)]
    if len(chosen) > 1 and along[-1] - along[chosen[-1]] < spacing_m / 2:
        chosen.pop()  # the last point takes its place
    return points[list(dict.fromkeys([*chosen, len(points) - 1]))]


def words_of(text: str) -> list[str]:
    """Returns the lower-case words and marks of an instruction."""
    return _WORD.findall(text.lower())


def vocabulary_of(texts: Iterable[str]) -> list[str]:
    """Returns the word list of some instructions: padding, unknown, then every word in alphabetical order."""
    words = {word for text in texts for word in words_of(text)}
    return [PAD, UNKNOWN, *sorted(words)]


def tokens_of_text(text: str, index: dict[str, int], length: int) -> list[int]:
    """Returns the numbers of the words of an instruction, padded with 0 to a fixed length."""
    tokens = [index.get(word, index[UNKNOWN]) for word in words_of(text)][:length]
    return tokens + [0] * (length - len(tokens))


def scene_file(scene: str) -> str:
    """Returns where an episode expects the mesh of its scene, below Habitat's folder of scenes."""
    return f"minivla/{scene}/{scene}.glb"


def vlnce_episode(meta: EpisodeMeta, poses: NDArray[np.float32], floor_height_m: float) -> dict[str, Any]:
    """Returns an entry of `episodes` without its tokens, which need the words of all.

    Args:
        meta: of the episode.
        poses: (T, 7) of base_link in our world frame.
        floor_height_m: of the scene; goals lie on the floor, as a navigation mesh has no other place.
    """
    job, rollout = meta.job, meta.rollout
    goal_x, goal_y, _ = meta.target_centroid_m
    track = thin_track(poses[:, :3].astype(np.float64))
    return {
        "episode_id": job.index,
        "trajectory_id": job.index,
        "scene_id": scene_file(job.scene),
        "start_position": to_habitat(poses[0, :3].tolist()),
        "start_rotation": rotation_of(float(yaw_of(poses[:1])[0])),
        "goals": [{"position": to_habitat((goal_x, goal_y, floor_height_m)), "radius": job.task.success_radius_m}],
        "reference_path": [to_habitat(point) for point in track.tolist()],
        "instruction": {"instruction_text": job.instruction},
        "info": {
            "geodesic_distance": meta.route.geodesic_m,
            "minivla_episode_id": meta.episode_id,
            "scene_sha256": job.scene_sha256,
            "split": str(job.split),
            "tier": str(job.tier),
            "template_id": job.template_id,
            "target_category": job.category,
            "target_id": job.target_id,
            "target_colour": job.colour,
            "target_centroid": to_habitat(meta.target_centroid_m),
            "expert_trajectory_length_m": rollout.trajectory_length_m,
            "expert_final_ne_m": rollout.final_ne_m,
        },
    }
