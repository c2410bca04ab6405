"""Numbers the episodes of a LeRobot dataset, sorted by split, so each split is a range. Pure functions.

Tasks are the instructions, numbered in order of first occurrence.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from factory.export.base import ExportPiece
from factory.export.lerobot.piece import LeRobotFacts
from schemas.terms import Split

_SPLIT_ORDER = {str(split): place for place, split in enumerate(Split)}
ABOUT = (
    "episode_id",
    "split",
    "scene",
    "spawn_tier",
    "target_category",
    "target_id",
    "template_id",
    "colour",
    "phrase_is_unique",
    "expert",
    "goal_x_m",
    "goal_y_m",
    "goal_z_m",
    "spawn_dist_m",
    "geodesic_m",
    "trajectory_length_m",
    "final_ne_m",
    "final_surface_m",
    "collision_count",
)


STATES_DIGEST = "states_digest"
"""Column with the digest of actions, poses and metadata of the episode, see `Episode.states_digest`."""


@dataclass(frozen=True, slots=True)
class Numbered:
    """Piece with its indices in the dataset."""

    piece: ExportPiece[LeRobotFacts]
    episode_index: int
    task_index: int
    task: str
    first: int
    """Index of its first frame in the dataset."""
    frames: int

    def numbers(self) -> dict[str, NDArray[np.int64]]:
        """Returns the index columns of the frames of this piece."""
        return {
            "episode_index": np.full(self.frames, self.episode_index, np.int64),
            "index": np.arange(self.first, self.first + self.frames, dtype=np.int64),
            "task_index": np.full(self.frames, self.task_index, np.int64),
        }

    def about(self) -> dict[str, Any]:
        """Returns the metadata of the episode for additional columns."""
        summary = self.piece.summary
        return {name: getattr(summary, name) for name in ABOUT} | {STATES_DIGEST: self.piece.facts.states_digest}


@dataclass(frozen=True)
class Numbering:
    """Pieces in the order of their numbers."""

    episodes: Sequence[Numbered]
    tasks: tuple[str, ...]
    splits: dict[str, str]
    """Split -> `start:stop` of its episodes."""
    frames: int

    def __iter__(self) -> Iterator[Numbered]:
        return iter(self.episodes)

    def __len__(self) -> int:
        return len(self.episodes)


def number_pieces(pieces: Sequence[ExportPiece[LeRobotFacts]], stride: int) -> Numbering:
    """Numbers the pieces by split, within a split in the order of the plan.

    Args:
        pieces: in the order of the plan.
        stride: stride of the exported frames.
    """
    ordered = sorted(pieces, key=lambda piece: (_SPLIT_ORDER.get(piece.split, len(_SPLIT_ORDER)), piece.split))
    tasks: dict[str, int] = {}
    numbered: list[Numbered] = []
    first = 0
    for number, piece in enumerate(ordered):
        row = piece.dataset[piece.position].summary
        task = row.instruction
        frames = -(-row.num_steps // stride)
        numbered.append(
            Numbered(
                piece, number, task_index=tasks.setdefault(task, len(tasks)), task=task, first=first, frames=frames
            )
        )
        first += frames
    return Numbering(numbered, tuple(tasks), _ranges(ordered), first)


def _ranges(ordered: Sequence[ExportPiece[LeRobotFacts]]) -> dict[str, str]:
    starts: dict[str, int] = {}
    stops: dict[str, int] = {}
    for number, piece in enumerate(ordered):
        starts.setdefault(piece.split, number)
        stops[piece.split] = number + 1
    return {split: f"{start}:{stops[split]}" for split, start in starts.items()}
