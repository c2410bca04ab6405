"""Caches the downscaled frames of a split as memory-mapped arrays, so that no epoch decodes a PNG again.

A cache is written to a temporary folder and renamed, so that an existing cache is complete. Its name is a digest of all
inputs: the content of the episodes, the size, the selected frames, and the version of the preprocessing. If several
trainings need the same cache, the first one writes it under a lock and the others wait. Trains nothing.
"""

from __future__ import annotations

import hashlib
import shutil
import time
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from factory.dataset.reader import Dataset, Episode
from factory.train import preprocess
from factory.train.labels import chosen_frames, label_episode, stop_frame
from schemas.base import Model, Positive, Sha256
from schemas.errors import UsageError, WorldError
from schemas.plan import canonical_json
from schemas.storage.disk import sync_directory, translated
from workers.client.host_lock import exclusive_lock

CACHE_FORMAT = 1
MASK_SHRINK = 8
"""Downscaling factor from the picture to the target mask: the resolution of the network's second stage."""
_INDEX = "index.json"
_POLL_S = 0.2
ProgressCallback = Callable[[int, int], None]


class CacheKey(Model):
    """Inputs that determine the content of a cache."""

    format: int = CACHE_FORMAT
    look: int = preprocess.PREPROCESS_VERSION
    dataset: Sha256
    """Digest of the cached episodes."""
    size: int
    hold: int

    @property
    def name(self) -> str:
        """Folder name of the cache."""
        return hashlib.sha256(canonical_json(self).encode()).hexdigest()[:32]


class CachedEpisode(Model):
    """Rows of one episode in a cache."""

    episode_id: str
    instruction: str
    category: str
    first: int
    frames: int


class _Index(Model):
    key: CacheKey
    episodes: tuple[CachedEpisode, ...]
    control_hz: int
    fov_deg: Positive
    max_speed_mps: Positive
    max_yaw_rate_rps: Positive


@dataclass(frozen=True)
class FrameCache:
    """Cached frames: N frames of the episodes in order, with memory-mapped pictures."""

    index: _Index
    rgb: NDArray[np.uint8]
    """(N, S, S, 3) sRGB."""
    depth: NDArray[np.uint16]
    """(N, S, S) depth, millimetres."""
    mask: NDArray[np.uint8]
    """(N, S/8, S/8) share of each cell that shows the target, 0..255."""
    actions: NDArray[np.float32]
    """(N, 2) action labels: v in m/s and w in rad/s."""
    is_stop: NDArray[np.bool_]
    """(N,) whether the label is a stop."""
    episode: NDArray[np.int32]
    """(N,) index of the frame's episode in `index.episodes`."""

    def __len__(self) -> int:
        return len(self.actions)


def open_cache(dataset: Dataset, size: int, hold: int, root: Path, tell: ProgressCallback) -> FrameCache:
    """Returns the frames of a dataset's episodes from the cache; decodes them if they are not cached.

    Args:
        dataset: Episodes to cache.
        size: Side of the pictures, pixels.
        hold: Steps between two selected frames.
        root: Folder of the caches.
        tell: Progress callback, called with decoded and total episodes, and with 0 while another training decodes
            them; may raise to cancel.

    Raises:
        UsageError: The dataset has no episodes, or they were recorded with different rates, cameras or robots.
        ArchiveCorrupt: An episode is damaged.
        WorldError: The cache cannot be written.
    """
    if not len(dataset):
        raise UsageError(
            f"{dataset.root} has no episodes of this split, scene and tier; `factory status` prints those that it has"
        )
    key = CacheKey(dataset=dataset.digest, size=size, hold=hold)
    folder = root / key.name

    def wait() -> None:
        tell(0, len(dataset))
        time.sleep(_POLL_S)

    index = _read_index(folder)
    if index is None or index.key != key:
        with translated("write the cache", folder):
            root.mkdir(parents=True, exist_ok=True)
            with exclusive_lock(root / f".{key.name}.lock", wait):
                index = _read_index(folder)  # another training may have written it in the meantime
                if index is None or index.key != key:
                    _make(dataset, key, folder, tell)
                    index = _read_index(folder)
    if index is None:
        raise WorldError(f"the cache {folder} was deleted while it was opened: run the command again")
    return _open(folder, index)


def _make(dataset: Dataset, key: CacheKey, folder: Path, tell: ProgressCallback) -> None:
    part = folder.with_name(f".{folder.name}.part")
    shutil.rmtree(part, ignore_errors=True)  # left by a killed training; this process holds the lock
    part.mkdir()
    try:
        _decode(dataset, key, part, tell)
        if folder.exists():
            shutil.rmtree(folder)
        part.rename(folder)
        sync_directory(folder.parent)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _decode(dataset: Dataset, key: CacheKey, part: Path, tell: ProgressCallback) -> None:
    lengths = dataset.metadata["num_steps"].to_pylist()
    chosen = [chosen_frames(steps, key.hold) for steps in lengths]
    rows = sum(map(len, chosen))
    side = key.size // MASK_SHRINK
    create = np.lib.format.open_memmap
    rgb = create(part / "rgb.npy", mode="w+", dtype=np.uint8, shape=(rows, key.size, key.size, 3))
    depth = create(part / "depth.npy", mode="w+", dtype=np.uint16, shape=(rows, key.size, key.size))
    mask = create(part / "mask.npy", mode="w+", dtype=np.uint8, shape=(rows, side, side))
    actions, is_stop = np.zeros((rows, 2), np.float32), np.zeros(rows, np.bool_)
    owner, episodes, first = np.zeros(rows, np.int32), [], 0
    settings: set[tuple[int, float, float, float]] = set()
    for number, (episode, frames) in enumerate(zip(dataset, chosen, strict=True)):
        with episode:
            here = slice(first, first + len(frames))
            settings.add(_settings(episode))
            actions[here], is_stop[here] = _labels(episode, frames, key.hold)
            owner[here] = number
            target = episode.meta.target_instance_id
            for row, t in enumerate(frames.tolist(), first):
                frame = episode.frame(t)
                rgb[row] = preprocess.shrink_rgb(frame.rgb, key.size)
                depth[row] = preprocess.shrink_depth(frame.depth, key.size)
                mask[row] = preprocess.shrink_mask(frame.ids, target, side)
            episodes.append(_describe(episode, first, len(frames)))
        first += len(frames)
        tell(number + 1, len(lengths))
    for array in (rgb, depth, mask):
        array.flush()
    np.savez(part / "labels.npz", actions=actions, is_stop=is_stop, episode=owner)
    if len(settings) > 1:
        raise UsageError(
            f"{dataset.root} has scenes with different rates, cameras or robots: select one scene with --scene"
        )
    hz, fov, speed, yaw_rate = settings.pop()
    index = _Index(
        key=key,
        episodes=tuple(episodes),
        control_hz=hz,
        fov_deg=fov,
        max_speed_mps=speed,
        max_yaw_rate_rps=yaw_rate,
    )
    (part / _INDEX).write_text(index.model_dump_json(), encoding="utf-8")


def _settings(episode: Episode) -> tuple[int, float, float, float]:
    job = episode.meta.job
    return job.task.control_hz, job.camera.fov_deg, job.robot.max_speed_mps, job.robot.max_yaw_rate_rps


def _labels(episode: Episode, frames: NDArray[np.int64], hold: int) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    job = episode.meta.job
    stop = stop_frame(episode.actions, job.robot.max_braking_mps2, job.task.control_hz)
    return label_episode(episode.actions, frames, stop, hold)


def _describe(episode: Episode, first: int, frames: int) -> CachedEpisode:
    return CachedEpisode(
        episode_id=episode.episode_id,
        instruction=episode.instruction,
        category=episode.summary.target_category,
        first=first,
        frames=frames,
    )


def _read_index(folder: Path) -> _Index | None:
    try:
        return _Index.model_validate_json((folder / _INDEX).read_bytes())
    except (FileNotFoundError, NotADirectoryError):
        return None
    except ValidationError:
        return None  # written by another version: written again


def _open(folder: Path, index: _Index) -> FrameCache:
    try:
        rgb, depth, mask = (np.load(folder / f"{name}.npy", mmap_mode="r") for name in ("rgb", "depth", "mask"))
        with (folder / "labels.npz").open("rb") as file, np.load(file) as labels:
            actions, is_stop, episode = labels["actions"], labels["is_stop"], labels["episode"]
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise WorldError(f"the cache {folder} is damaged ({error}): delete that folder; it is created again") from error
    return FrameCache(index, rgb, depth, mask, actions, is_stop, episode)
