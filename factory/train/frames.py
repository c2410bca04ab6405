"""Frames of a training: their labels (the twist to hold, and whether to stop), and how their pictures are read.

Decodes and renders nothing.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from factory.dataset.reader import Dataset, Episode, Frame
from factory.dataset.sampler import scene_numbers
from factory.train import preprocess
from factory.train.input_size import PREPROCESS_VERSION
from factory.train.options import StopRule
from schemas.base import Model, Positive, Sha256
from schemas.bundle import Corrections
from schemas.episode import EpisodeMeta
from schemas.errors import UsageError
from schemas.measure import Goal, StopLabel, goal_bearings, stop_labels
from schemas.plan import canonical_json
from schemas.support.numpy_types import Floats

_TAIL_STEPS, _TAIL_STRIDE = 30, 2
"""Length and stride of the denser sampling at the end of an episode, steps. The stop takes about half a second."""


class Labels(NamedTuple):
    """Labels of the selected frames, one row each."""

    actions: NDArray[np.float32]
    """(N, 2) v in m/s and w in rad/s to hold until the next selected frame; (0, 0) without a twist."""
    is_stop: NDArray[np.bool_]
    """(N,) whether the robot should stop."""
    has_stop: NDArray[np.bool_]
    """(N,) whether `is_stop` is a label; otherwise both answers are right."""
    has_twist: NDArray[np.bool_]
    """(N,) whether `actions` is a label."""
    goal: NDArray[np.float32]
    """(N, 2) distance to the target by the success measure, metres, and its bearing, radians, counter-clockwise; NaN
    for a false premise."""

    def take(self, rows: NDArray[np.int64]) -> Labels:
        """Returns the labels of some rows."""
        taken = (self.actions[rows], self.is_stop[rows], self.has_stop[rows], self.has_twist[rows])
        return Labels(*taken, self.goal[rows])

    @classmethod
    def joined(cls, parts: Sequence[Labels]) -> Labels:
        """Returns the rows of several labels, in order."""
        return cls(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


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


def label_episode(
    actions: NDArray[np.float32],
    frames: NDArray[np.int64],
    stop: int,
    hold: int,
    goal: NDArray[np.float32],
    when: NDArray[np.uint8] | None = None,
) -> Labels:
    """Returns the labels of the selected frames of a demonstration.

    The twist of a frame is the command at the end of its hold time, or at the last frame before the stop if that is
    earlier. The end is used because the first commands of an episode only reflect the acceleration limit.

    Args:
        actions: (T, 2) recorded commands.
        frames: (N,) selected frames.
        stop: First frame of the stop.
        hold: Steps for which an action is held.
        goal: (T, 2) `Labels.goal` of all steps.
        when: (T,) labels of `stop_labels`; `None` labels the frames from the expert's stop on as stops.
    """
    brakes = frames >= stop
    last = np.minimum(frames + hold - 1, max(0, min(stop, len(actions)) - 1))
    wanted = actions[np.where(brakes, frames, last)].astype(np.float32)
    wanted[brakes] = 0.0
    if when is None:
        return Labels(wanted, brakes, np.ones_like(brakes), ~brakes, goal[frames])
    return _with_stops(wanted, when[frames], ~brakes, goal[frames])


def label_corrections(
    corrections: Corrections, frames: NDArray[np.int64], when: NDArray[np.uint8], goal: NDArray[np.float32]
) -> Labels:
    """Returns the labels of the selected frames of an episode with corrections.

    Args:
        corrections: actions of the planner at the poses.
        frames: (N,) selected frames.
        when: (T,) labels of `stop_labels`.
        goal: (T, 2) `Labels.goal` of all steps.
    """
    wanted = corrections.expert_actions[frames].astype(np.float32)
    is_driven = np.isfinite(wanted).all(axis=1)
    wanted[~is_driven] = 0.0
    return _with_stops(wanted, when[frames], is_driven & (wanted != 0).any(axis=1), goal[frames])


def _with_stops(
    wanted: NDArray[np.float32], when: NDArray[np.uint8], is_driven: NDArray[np.bool_], goal: NDArray[np.float32]
) -> Labels:
    is_stop = when == StopLabel.STOP
    wanted = np.where(is_stop[:, None], np.float32(0), wanted)
    return Labels(wanted, is_stop, when != StopLabel.EITHER, is_driven & ~is_stop, goal)


def goal_labels(meta: EpisodeMeta, poses: Floats) -> NDArray[np.float32]:
    """Returns `Labels.goal` of all steps, (T, 2).

    Args:
        meta: metadata of the episode.
        poses: (T, 7) poses of base_link in the world frame.
    """
    if meta.job.is_false_premise:
        return np.full((len(poses), 2), np.nan, np.float32)
    goal = Goal.of_episode(meta)
    return np.stack([goal.distances(poses[:, :2]), goal_bearings(goal, poses)], axis=1).astype(np.float32)


def corrected_frames(corrections: Corrections, when: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Returns the training frames of an episode with corrections: those with a label of the planner, and more stops."""
    steps = len(corrections.drivers)
    labelled = np.isfinite(corrections.expert_actions).all(axis=1)
    in_tail = np.zeros(steps, np.bool_)
    in_tail[max(0, steps - _TAIL_STEPS) :: _TAIL_STRIDE] = True
    return np.flatnonzero(labelled | (in_tail & (when != StopLabel.EITHER)))


CACHE_FORMAT = 3
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
    stops: StopRule

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


class JoinedPictures:
    """`PictureSource` of several sources, whose rows follow each other.

    Args:
        parts: sources with the number of their rows.
    """

    def __init__(self, parts: Sequence[tuple[PictureSource, int]]) -> None:
        self._sources = [source for source, _ in parts]
        self._ends = np.cumsum([count for _, count in parts])

    def take(self, rows: NDArray[np.int64]) -> Pictures:
        """Returns the pictures of these rows, in their order."""
        owner = np.searchsorted(self._ends, rows, side="right")
        places = [np.flatnonzero(owner == number) for number in range(len(self._sources))]
        starts = [0, *self._ends[:-1].tolist()]
        taken = [
            source.take(rows[place] - start)
            for source, place, start in zip(self._sources, places, starts, strict=True)
            if len(place)
        ]
        back = np.argsort(np.concatenate([place for place in places if len(place)]))
        return Pictures(*(np.concatenate(arrays)[back] for arrays in zip(*taken, strict=True)))


class PictureSource(Protocol):
    """Source of the pictures of a training: memory, files, or a renderer."""

    def take(self, rows: NDArray[np.int64]) -> Pictures:
        """Returns the pictures of these rows, in their order."""


@dataclass(frozen=True)
class TrainingFrames:
    """N frames of the episodes in order, with their labels."""

    index: FramesIndex
    labels: Labels
    episode: NDArray[np.int32]
    """(N,) index of the frame's episode in `index.episodes`."""
    scene: NDArray[np.int64]
    """(N,) number of the frame's scene, 0, 1, ..."""
    pictures: PictureSource

    def __len__(self) -> int:
        return len(self.episode)


def join_frames(parts: Sequence[TrainingFrames]) -> TrainingFrames:
    """Returns the frames of several datasets as those of one training, in order.

    Raises:
        UsageError: The datasets were recorded with different rates, cameras or robots.
    """
    if len(parts) == 1:
        return parts[0]
    first = parts[0].index
    shared = {name: getattr(first, name) for name in ("control_hz", "fov_deg", "max_speed_mps", "max_yaw_rate_rps")}
    if any({name: getattr(part.index, name) for name in shared} != shared for part in parts):
        raise UsageError("the corrections were recorded with another rate, camera or robot than the dataset")
    episodes: list[LabelledEpisode] = []
    owners, numbers, rows, scenes = [], [], 0, 0
    for part in parts:
        owners.append(part.episode + len(episodes))
        numbers.append(part.scene + scenes)
        episodes += [each.model_copy(update={"first": each.first + rows}) for each in part.index.episodes]
        rows, scenes = rows + len(part), scenes + int(part.scene.max()) + 1
    digest = hashlib.sha256(" ".join(part.index.key.dataset for part in parts).encode()).hexdigest()
    index = first.model_copy(
        update={"episodes": tuple(episodes), "key": first.key.model_copy(update={"dataset": digest})}
    )
    return TrainingFrames(
        index,
        Labels.joined([part.labels for part in parts]),
        episode=np.concatenate(owners).astype(np.int32),
        scene=np.concatenate(numbers),
        pictures=JoinedPictures([(part.pictures, len(part)) for part in parts]),
    )


@dataclass(frozen=True)
class LabelledSteps:
    """Selected steps of all episodes, with their labels; one row each."""

    index: FramesIndex
    step: NDArray[np.int64]
    labels: Labels
    episode: NDArray[np.int32]

    def with_pictures(self, dataset: Dataset, pictures: PictureSource) -> TrainingFrames:
        scene = scene_numbers(dataset)[self.episode]
        return TrainingFrames(self.index, self.labels, episode=self.episode, scene=scene, pictures=pictures)


def label_steps(dataset: Dataset, size: int, hold: int, stops: StopRule, tell: ProgressCallback) -> LabelledSteps:
    """Selects the steps of a training and computes their labels.

    Args:
        dataset: Episodes to train on.
        size: Side of the pictures, pixels.
        hold: Steps between two selected frames.
        stops: Rule of the stop labels.
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
            chosen, of_episode = _label(episode, hold, stops)
            settings.add(_settings(episode))
            labels.append(of_episode)
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
        key=CacheKey(dataset=dataset.digest, size=size, hold=hold, stops=stops),
        episodes=tuple(episodes),
        control_hz=hz,
        fov_deg=fov,
        max_speed_mps=speed,
        max_yaw_rate_rps=yaw_rate,
    )
    owner = np.repeat(np.arange(len(steps), dtype=np.int32), list(map(len, steps)))
    return LabelledSteps(index, np.concatenate(steps), Labels.joined(labels), episode=owner)


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


def _label(episode: Episode, hold: int, stops: StopRule) -> tuple[NDArray[np.int64], Labels]:
    """Returns the training frames of an episode, and their labels."""
    meta, corrections = episode.meta, episode.corrections
    goal = goal_labels(meta, episode.poses)
    if corrections is not None:  # its end says nothing about the policy's stops before
        when = stop_labels(meta, episode.poses)
        frames = corrected_frames(corrections, when)
        return frames, label_corrections(corrections, frames, when, goal)
    frames, job = chosen_frames(len(episode), hold), meta.job
    stop = stop_frame(episode.actions, job.robot.max_braking_mps2, job.task.control_hz)
    with_success = stop_labels(meta, episode.poses) if stops == "success" else None
    return frames, label_episode(episode.actions, frames, stop, hold, goal, with_success)


def _describe(episode: Episode, first: int, frames: int) -> LabelledEpisode:
    return LabelledEpisode(
        episode_id=episode.episode_id,
        instruction=episode.instruction,
        category=episode.summary.target_category,
        first=first,
        frames=frames,
    )
