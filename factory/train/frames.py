"""Frames of a training: their labels (the twist to hold, and whether to stop), and how their pictures are read.

Decodes and renders nothing.
"""

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
from schemas.base import Model, Positive, Sha256
from schemas.errors import UsageError
from schemas.plan import canonical_json

_TAIL_STEPS, _TAIL_STRIDE = 30, 2
"""Length and stride of the denser sampling at the end of an episode, steps. The stop takes about half a second."""


class Labels(NamedTuple):
    """Labels of the selected frames, one row each."""

    actions: NDArray[np.float32]
    """(N, 2) v in m/s and w in rad/s to hold until the next selected frame; (0, 0) for a stop."""
    is_stop: NDArray[np.bool_]
    """(N,) whether the expert stops from this frame on."""


def stop_frame(actions: NDArray[np.float32], max_braking_mps2: float, control_hz: int) -> int:
    """Returns the first frame of the final full braking, or the number of frames if there is none.

    The recorded commands are slew limited: the expert's decision to stop appears as a speed that decreases at the
    braking limit to 0 and remains there. A speed that the expert reduces with the distance to the target falls
    ten times more slowly.

    Args:
        actions: (T, 2) recorded commands.
        max_braking_mps2: Slew limit of braking, m/s2.
        control_hz: Control rate, Hz.
    """
    speed = actions[:, 0].astype(np.float64)
    if not len(speed) or speed[-1] > 0:
        return len(speed)
    least = 0.5 * max_braking_mps2 / control_hz
    before = np.concatenate([speed[:1], speed[:-1]])
    braking = (speed == 0) | (before - speed >= least)
    others = np.flatnonzero(~braking)
    return int(others[-1]) + 1 if len(others) else 0


def chosen_frames(steps: int, stride: int) -> NDArray[np.int64]:
    """Returns the indices of the training frames: every `stride`-th frame, and more in the last half second."""
    tail = range(max(0, steps - _TAIL_STEPS), steps, _TAIL_STRIDE)
    return np.array(sorted({*range(0, steps, stride), *tail}), np.int64)


def label_episode(actions: NDArray[np.float32], frames: NDArray[np.int64], stop: int, hold: int) -> Labels:
    """Returns the labels of the selected frames.

    The twist of a frame is the command at the end of its hold time, or at the last frame before the stop if that is
    earlier. The end is used because the first commands of an episode only reflect the acceleration limit.

    Args:
        actions: (T, 2) recorded commands.
        frames: (N,) selected frames.
        stop: First frame of the stop.
        hold: Steps for which an action is held.
    """
    is_stop = frames >= stop
    last = np.minimum(frames + hold - 1, max(0, min(stop, len(actions)) - 1))
    wanted = actions[np.where(is_stop, frames, last)].astype(np.float32)
    wanted[is_stop] = 0.0
    return Labels(wanted, is_stop)


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
        scene = scene_numbers(dataset)[self.episode]
        return TrainingFrames(
            self.index, self.actions, is_stop=self.is_stop, episode=self.episode, scene=scene, pictures=pictures
        )


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
    return LabelledSteps(index, np.concatenate(steps), actions=actions, is_stop=is_stop, episode=owner)


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
