"""Frames of a training: their labels, and how their pictures are read. Decodes and renders nothing."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from factory.dataset.reader import Dataset, Episode, Frame
from factory.dataset.sampler import scene_numbers
from factory.train import preprocess
from factory.train.input_size import PREPROCESS_VERSION
from factory.train.labels import Labels, chosen_frames, label_episode, stop_frame
from schemas.base import Model, Positive, Sha256
from schemas.errors import UsageError
from schemas.plan import canonical_json

CACHE_FORMAT = 1
MASK_SHRINK = 8
"""Downscaling factor from the picture to the target mask, which has the resolution of the network's second stage."""
ProgressCallback = Callable[[int, int], None]


class CacheKey(Model):
    """Inputs that determine the frames of a training, and the content of a cache."""

    format: int = CACHE_FORMAT
    look: int = PREPROCESS_VERSION
    dataset: Sha256
    """Digest of the episodes."""
    size: int
    hold: int

    @property
    def name(self) -> str:
        """Folder name of the cache."""
        return hashlib.sha256(canonical_json(self).encode()).hexdigest()[:32]


class LabelledEpisode(Model):
    """Episode and its rows in the arrays of the training: `frames` rows, starting at row `first`."""

    episode_id: str
    instruction: str
    category: str
    first: int
    frames: int


class FramesIndex(Model):
    """Episodes of a training, and the settings that they have in common."""

    key: CacheKey
    episodes: tuple[LabelledEpisode, ...]
    control_hz: int
    fov_deg: Positive
    max_speed_mps: Positive
    max_yaw_rate_rps: Positive


class Pictures(NamedTuple):
    """Downscaled frames."""

    rgb: NDArray[np.uint8]
    """(N, S, S, 3) sRGB."""
    depth: NDArray[np.uint16]
    """(N, S, S) depth, millimetres."""
    mask: NDArray[np.uint8]
    """(N, S/8, S/8) share of each cell that shows the target, 0..255."""

    @classmethod
    def empty(cls, count: int, size: int) -> Pictures:
        """Returns uninitialised pictures; unused pages take no memory."""
        side = size // MASK_SHRINK
        rgb, depth = np.empty((count, size, size, 3), np.uint8), np.empty((count, size, size), np.uint16)
        return cls(rgb, depth, np.empty((count, side, side), np.uint8))

    def put(self, row: int, frame: Frame, instance_id: int) -> None:
        """Downscales a frame into a row; the width of the frame is a multiple of that of the pictures."""
        size, side = self.rgb.shape[1], self.mask.shape[1]
        self.rgb[row] = preprocess.shrink_rgb(frame.rgb, size)
        self.depth[row] = preprocess.shrink_depth(frame.depth, size)
        self.mask[row] = preprocess.shrink_mask(frame.ids, instance_id, side)

    def take(self, rows: NDArray[np.int64]) -> Pictures:
        """Returns copies of these rows."""
        return Pictures(np.asarray(self.rgb[rows]), np.asarray(self.depth[rows]), np.asarray(self.mask[rows]))

    def copy_row(self, row: int, source: Pictures, source_row: int) -> None:
        """Copies a row of other pictures into a row of these."""
        self.rgb[row], self.depth[row] = source.rgb[source_row], source.depth[source_row]
        self.mask[row] = source.mask[source_row]


class PictureSource(Protocol):
    """Source of the pictures of a training: memory, files, or a renderer."""

    def take(self, rows: NDArray[np.int64]) -> Pictures:
        """Returns the pictures of these rows, in their order."""


@dataclass(frozen=True)
class TrainingFrames:
    """N frames of the episodes in order, with their labels."""

    index: FramesIndex
    actions: NDArray[np.float32]
    """(N, 2) action labels: v in m/s and w in rad/s."""
    is_stop: NDArray[np.bool_]
    """(N,) whether the label is a stop."""
    episode: NDArray[np.int32]
    """(N,) index of the frame's episode in `index.episodes`."""
    scene: NDArray[np.int64]
    """(N,) number of the frame's scene, 0, 1, ..."""
    pictures: PictureSource

    def __len__(self) -> int:
        return len(self.actions)


@dataclass(frozen=True)
class LabelledSteps:
    """Selected steps of all episodes, with their labels; one row each."""

    index: FramesIndex
    step: NDArray[np.int64]
    actions: NDArray[np.float32]
    is_stop: NDArray[np.bool_]
    episode: NDArray[np.int32]

    def with_pictures(self, dataset: Dataset, pictures: PictureSource) -> TrainingFrames:
        """Returns the frames of a training."""
        scene = scene_numbers(dataset)[self.episode]
        return TrainingFrames(self.index, self.actions, self.is_stop, self.episode, scene, pictures)


def label_steps(dataset: Dataset, size: int, hold: int, tell: ProgressCallback) -> LabelledSteps:
    """Selects the steps of a training and computes their labels.

    Args:
        dataset: Episodes to train on.
        size: Side of the pictures, pixels.
        hold: Steps between two selected frames.
        tell: Progress callback, called with finished and total episodes.

    Raises:
        UsageError: The dataset has no episodes, or they were recorded with different rates, cameras or robots.
        ArchiveCorrupt: An episode is damaged.
    """
    require_episodes(dataset)
    settings: set[tuple[int, float, float, float]] = set()
    episodes: list[LabelledEpisode] = []
    steps, labels, first = [], [], 0
    for number, episode in enumerate(dataset):
        with episode:
            chosen = chosen_frames(len(episode), hold)
            settings.add(_settings(episode))
            labels.append(_labels(episode, chosen, hold))
            episodes.append(_describe(episode, first, len(chosen)))
        steps.append(chosen)
        first += len(chosen)
        tell(number + 1, len(dataset))
    if len(settings) > 1:
        raise UsageError(
            f"{dataset.root} has scenes with different rates, cameras or robots: select one scene with --scene"
        )
    hz, fov, speed, yaw_rate = settings.pop()
    index = FramesIndex(
        key=CacheKey(dataset=dataset.digest, size=size, hold=hold),
        episodes=tuple(episodes),
        control_hz=hz,
        fov_deg=fov,
        max_speed_mps=speed,
        max_yaw_rate_rps=yaw_rate,
    )
    actions, is_stop = (np.concatenate(parts) for parts in zip(*labels, strict=True))
    owner = np.repeat(np.arange(len(steps), dtype=np.int32), list(map(len, steps)))
    return LabelledSteps(index, np.concatenate(steps), actions, is_stop, owner)


def require_episodes(dataset: Dataset) -> None:
    """Raises an error if a dataset is empty.

    Raises:
        UsageError: The dataset has no episodes.
    """
    if not len(dataset):
        raise UsageError(
            f"{dataset.root} has no episodes of this split, scene and tier; `factory status` lists its episodes"
        )


def _settings(episode: Episode) -> tuple[int, float, float, float]:
    job = episode.meta.job
    return job.task.control_hz, job.camera.fov_deg, job.robot.max_speed_mps, job.robot.max_yaw_rate_rps


def _labels(episode: Episode, frames: NDArray[np.int64], hold: int) -> Labels:
    job = episode.meta.job
    stop = stop_frame(episode.actions, job.robot.max_braking_mps2, job.task.control_hz)
    return label_episode(episode.actions, frames, stop, hold)


def _describe(episode: Episode, first: int, frames: int) -> LabelledEpisode:
    return LabelledEpisode(
        episode_id=episode.episode_id,
        instruction=episode.instruction,
        category=episode.summary.target_category,
        first=first,
        frames=frames,
    )
