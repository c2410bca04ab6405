"""Caches the downscaled frames of a split as memory-mapped arrays, so no epoch decodes a PNG again.

A cache is written to a temporary folder and renamed, so an existing cache is complete. Its name is a digest of all
inputs: the content of the episodes, the size, the selected frames, and the version of the preprocessing. If several
trainings need the same cache, the first one writes it under a lock and the others wait.
"""

from __future__ import annotations

import shutil
import time
import zipfile
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from factory.dataset.reader import Dataset
from factory.dataset.sampler import scene_numbers
from factory.train.frames import (
    MASK_SHRINK,
    CacheKey,
    FramesIndex,
    LabelledSteps,
    Pictures,
    ProgressCallback,
    TrainingFrames,
    label_steps,
    require_episodes,
)
from schemas.errors import WorldError
from schemas.storage.disk import sync_directory, translated
from workers.client.host_lock import exclusive_lock

_INDEX = "index.json"
_POLL_S = 0.2


def open_cache(dataset: Dataset, size: int, hold: int, root: Path, tell: ProgressCallback) -> TrainingFrames:
    """Returns the frames of a dataset's episodes from the cache; decodes them if they are not cached.

    Args:
        dataset: Episodes to cache.
        size: Side of the pictures, pixels.
        hold: Steps between two selected frames.
        root: Folder of the caches.
        tell: Progress callback, called with the number of decoded episodes and the total; the number stays 0 while
            another training decodes them. May raise to cancel.

    Raises:
        UsageError: The dataset has no episodes, or they were recorded with different rates, cameras or robots.
        ArchiveCorrupt: An episode is damaged.
        WorldError: The cache cannot be written.
    """
    require_episodes(dataset)
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
    return _open(folder, index, dataset)


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
    found = label_steps(dataset, key.size, key.hold, lambda _done, _of: None)
    pictures = _create(part, len(found.step), key.size)
    for number, (episode, rows) in enumerate(zip(dataset, found.index.episodes, strict=True)):
        with episode:
            for row in range(rows.first, rows.first + rows.frames):
                pictures.put(row, episode.frame(int(found.step[row])), episode.meta.target_instance_id)
        tell(number + 1, len(dataset))
    for array in pictures:
        array.flush()  # type: ignore[union-attr]
    _write_labels(part, found)


def _create(part: Path, rows: int, size: int) -> Pictures:
    """Returns new memory-mapped files."""
    side = size // MASK_SHRINK
    create = np.lib.format.open_memmap
    rgb = create(part / "rgb.npy", mode="w+", dtype=np.uint8, shape=(rows, size, size, 3))
    depth = create(part / "depth.npy", mode="w+", dtype=np.uint16, shape=(rows, size, size))
    return Pictures(rgb, depth, create(part / "mask.npy", mode="w+", dtype=np.uint8, shape=(rows, side, side)))


def _write_labels(part: Path, found: LabelledSteps) -> None:
    np.savez(part / "labels.npz", actions=found.actions, is_stop=found.is_stop, episode=found.episode)
    (part / _INDEX).write_text(found.index.model_dump_json(), encoding="utf-8")


def _read_index(folder: Path) -> FramesIndex | None:
    try:
        return FramesIndex.model_validate_json((folder / _INDEX).read_bytes())
    except (FileNotFoundError, NotADirectoryError):
        return None
    except ValidationError:
        return None  # written by another version; the caller replaces it


def _open(folder: Path, index: FramesIndex, dataset: Dataset) -> TrainingFrames:
    try:
        rgb, depth, mask = (np.load(folder / f"{name}.npy", mmap_mode="r") for name in ("rgb", "depth", "mask"))
        with (folder / "labels.npz").open("rb") as file, np.load(file) as labels:
            actions, is_stop, episode = labels["actions"], labels["is_stop"], labels["episode"]
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise WorldError(f"the cache {folder} is damaged ({error}): delete that folder; it is created again") from error
    return TrainingFrames(index, actions, is_stop, episode, scene_numbers(dataset)[episode], Pictures(rgb, depth, mask))
