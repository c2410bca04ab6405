"""Converts one episode to the conventions of VLN-CE and Habitat: axes, reference path, instruction tokens.

The world of Habitat is x right, y up, z backward (towards the viewer); an agent faces its local -z. The world of this
project is x forward, y left, z up (REP 103); the robot faces +x. The rotation is (x, y, z) -> (x, z, -y).

Pure functions.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.dataset.origin import EpisodeOrigin
from schemas.episode import EpisodeMeta
from schemas.language.route.meaning import SubInstruction
from schemas.support.geometry import yaw_of
from schemas.terms import SuccessMeasure

PAD, UNKNOWN = "<pad>", "<unk>"
_WORD = re.compile(r"[a-z0-9]+|[^\sa-z0-9]")
_SPACING_M = 0.25
"""Distance between points of the reference path, metres; equal to the step of VLN-CE agents."""
_GOAL_SPACING_M = 0.25
"""Largest distance between goals along the edge of a footprint, metres."""


class EpisodeText(NamedTuple):
    """Instruction of an episode."""

    instruction: str
    """Text; in a relabelled dataset, the new instruction."""
    template_id: str
    """Id of the sentence pattern of the text."""
    steps: tuple[SubInstruction, ...] = ()
    """Sub-instructions of a route."""


Vector = tuple[float, float, float]


def to_habitat(point: Sequence[float]) -> Vector:
    """Converts a point from the REP 103 world frame to Habitat's: (x, y, z) -> (x, z, -y), metres."""
    x, y, z = (float(value) for value in point)
    return (x, z, -y + 0.0)


def from_habitat(point: Sequence[float]) -> Vector:
    """Converts a point from Habitat's world frame to the REP 103 world frame; inverse of `to_habitat`."""
    x, y, z = (float(value) for value in point)
    return (x, -z + 0.0, y)


def rotation_of(yaw_rad: float) -> tuple[float, float, float, float]:
    """Returns the quaternion (x, y, z, w) of a Habitat agent with the REP 103 heading `yaw_rad`.

    At heading 90 degrees, along +y, the agent faces Habitat's -z and the rotation is the identity.
    """
    half = (yaw_rad - math.pi / 2) / 2
    return (0.0, math.sin(half), 0.0, math.cos(half))


def thin_track(points: NDArray[np.float64], spacing_m: float = _SPACING_M) -> NDArray[np.float64]:
    """Returns points of a track (T, 3) about `spacing_m` apart along it, including the first and the last point."""
    steps = np.linalg.norm(np.diff(points[:, :2], axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    marks = np.arange(0.0, along[-1], spacing_m)
    chosen = [int(index) for index in np.searchsorted(along, marks)]
    if len(chosen) > 1 and along[-1] - along[chosen[-1]] < spacing_m / 2:
        chosen.pop()  # the last point of the track replaces it
    return points[list(dict.fromkeys([*chosen, len(points) - 1]))]


def words_of(text: str) -> list[str]:
    """Returns the lower-case words and punctuation marks of an instruction."""
    return _WORD.findall(text.lower())


def vocabulary_of(texts: Iterable[str]) -> list[str]:
    """Returns the vocabulary of instructions: padding, unknown, then all words in alphabetical order."""
    words = {word for text in texts for word in words_of(text)}
    return [PAD, UNKNOWN, *sorted(words)]


def tokens_of_text(text: str, index: dict[str, int], length: int) -> list[int]:
    """Returns the token ids of an instruction, padded with 0 to a fixed length."""
    tokens = [index.get(word, index[UNKNOWN]) for word in words_of(text)][:length]
    return tokens + [0] * (length - len(tokens))


def scene_file(scene: str) -> str:
    """Returns the path of the mesh of a scene, relative to Habitat's folder of scenes."""
    return f"minivla/{scene}/{scene}.glb"


def _goal_points(meta: EpisodeMeta, poses: NDArray[np.float64]) -> list[tuple[float, float]]:
    """Returns the goals x, y: the centroid of the target, or its edge points if success is measured to the footprint.

    Habitat measures the distance to the nearest goal. The first goal is the one that is nearest to the last pose.
    """
    if meta.job.task.success is SuccessMeasure.CENTROID:
        return [meta.target_centroid_m[:2]]
    points: list[tuple[float, float]] = []
    vertices = np.array(meta.target_footprint_m)
    for start, end in zip(vertices, np.roll(vertices, -1, axis=0), strict=True):
        steps = max(1, math.ceil(math.dist(start, end) / _GOAL_SPACING_M))
        points += [tuple(point) for point in (start + (end - start) * np.arange(steps)[:, None] / steps).tolist()]
    last = poses[-1, :2].tolist()
    return sorted(points, key=lambda point: math.dist(point, last))


def vlnce_episode(
    meta: EpisodeMeta, poses: NDArray[np.float64], floor_height_m: float, text: EpisodeText, origin: EpisodeOrigin
) -> dict[str, Any]:
    """Returns an entry of `episodes` without tokens, which need the vocabulary of all episodes.

    Args:
        meta: metadata of the episode.
        poses: (T, 7) poses of base_link in the REP 103 world frame.
        floor_height_m: height of the floor, metres; goals are on the floor, because a navigation mesh covers only it.
        text: instruction and its sub-instructions.
        origin: what simulates the episode again; its number in the dataset is that of the entry.
    """
    job, rollout = meta.job, meta.rollout
    number = int(origin.episode.removeprefix("ep_"))
    track = thin_track(poses[:, :3])
    return {
        "episode_id": number,
        "trajectory_id": number,
        "scene_id": scene_file(job.scene),
        "start_position": to_habitat(poses[0, :3].tolist()),
        "start_rotation": rotation_of(float(yaw_of(poses[:1])[0])),
        "goals": [
            {"position": to_habitat((x, y, floor_height_m)), "radius": job.task.success_radius_m}
            for x, y in _goal_points(meta, poses)
        ],
        "reference_path": [to_habitat(point) for point in track.tolist()],
        "instruction": {"instruction_text": text.instruction},
        "info": {
            "geodesic_distance": meta.route.geodesic_m,
            "minivla_episode_id": origin.episode,
            "origin": origin.model_dump(mode="json"),
            "scene_sha256": job.scene_sha256,
            "split": str(job.split),
            "tier": str(job.tier),
            "template_id": text.template_id,
            "target_category": job.category,
            "target_id": job.target_id,
            "target_colour": job.colour,
            "target_centroid": to_habitat(meta.target_centroid_m),
            "expert_trajectory_length_m": rollout.trajectory_length_m,
            "expert_final_ne_m": rollout.final_ne_m,
            **({"sub_instructions": [_sub_instruction(each) for each in text.steps]} if text.steps else {}),
        },
    }


def _sub_instruction(each: SubInstruction) -> dict[str, Any]:
    """Returns a sub-instruction with its span of `locations` in the file of paths."""
    return {"text": each.text, "start": each.start, "end": each.end}
