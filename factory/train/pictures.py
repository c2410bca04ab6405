"""Pictures of a training: cached on disk for frames recordings, rendered and kept in memory for states recordings.

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
from numpy.typing import NDArray
from pydantic import ValidationError

from factory.dataset.parallel import OpenEpisodes, for_each
from factory.dataset.reader import Dataset, Episode
from factory.dataset.sampler import scene_numbers
from factory.train.frames import (
    MASK_SHRINK,
    CacheKey,
    FramesIndex,
    LabelledSteps,
    Labels,
    Pictures,
    ProgressCallback,
    TrainingFrames,
    label_steps,
    require_episodes,
)
from factory.train.options import StopRule
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.errors import WorldError
from schemas.storage.disk import sync_directory, translated
from workers.client.host_lock import exclusive_lock

_INDEX = "index.json"
_POLL_S = 0.2


def open_cache(
    dataset: Dataset, size: int, hold: int, stops: StopRule, root: Path, tell: ProgressCallback
) -> TrainingFrames:
    """Returns the frames of a dataset's episodes from the cache; decodes them if they are not cached.

    Args:
        dataset: Episodes to cache.
        size: Side of the pictures, pixels.
        hold: Steps between two selected frames.
        stops: Rule of the stop labels.
        root: Folder of the caches.
        tell: Progress callback, called with the number of decoded episodes and the total; the number stays 0 while
            another training decodes them. May raise to cancel.

    Raises:
        UsageError: The dataset has no episodes, or they were recorded with different rates, cameras or robots.
        ArchiveCorrupt: An episode is damaged.
        WorldError: The cache cannot be written.
    """
    require_episodes(dataset)
    key = CacheKey(dataset=dataset.digest, size=size, hold=hold, stops=stops)
    folder = root / key.name

    def wait() -> None:
        tell(0, len(dataset))
        time.sleep(_POLL_S)

    index = _read_index(folder)
    if index is None or index.key != key:
        with translated("write the cache", folder):
            root.mkdir(parents=True, exist_ok=True)
            # without the lock, the rename of one training would delete files that another one has mapped
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
    labels = label_steps(dataset, key.size, key.hold, key.stops, lambda _done, _of: None)
    pictures = _create(part, len(labels.step), key.size)
    for number, (episode, rows) in enumerate(zip(dataset, labels.index.episodes, strict=True)):
        with episode:
            for row in range(rows.first, rows.first + rows.frames):
                pictures.put(row, episode.frame(int(labels.step[row])), episode.meta.target_instance_id)
        tell(number + 1, len(dataset))
    for array in pictures:
        array.flush()  # type: ignore[union-attr]
    _write_labels(part, labels)


def _create(part: Path, rows: int, size: int) -> Pictures:
    """Returns new memory-mapped files."""
    side = size // MASK_SHRINK
    create = np.lib.format.open_memmap
    rgb = create(part / "rgb.npy", mode="w+", dtype=np.uint8, shape=(rows, size, size, 3))
    depth = create(part / "depth.npy", mode="w+", dtype=np.uint16, shape=(rows, size, size))
    return Pictures(rgb, depth, create(part / "mask.npy", mode="w+", dtype=np.uint8, shape=(rows, side, side)))


def _write_labels(part: Path, labels: LabelledSteps) -> None:
    np.savez(part / "labels.npz", episode=labels.episode, **labels.labels._asdict())
    (part / _INDEX).write_text(labels.index.model_dump_json(), encoding="utf-8")


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
            columns, episode = Labels(*(labels[name] for name in Labels._fields)), labels["episode"]
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise WorldError(f"the cache {folder} is damaged ({error}): delete that folder; it is created again") from error
    return TrainingFrames(
        index,
        columns,
        episode=episode,
        scene=scene_numbers(dataset)[episode],
        pictures=Pictures(rgb, depth, mask),
    )


def render_frames(
    dataset: Dataset,
    size: int,
    hold: int,
    stops: StopRule,
    antialias: int | None,
    memory_bytes: int,
    tell: ProgressCallback,
) -> TrainingFrames:
    """Returns the frames of a dataset's episodes, which are rendered when they are used.

    Args:
        dataset: Episodes that store states.
        size: Side of the pictures, pixels.
        hold: Steps between two selected frames.
        stops: Rule of the stop labels.
        antialias: Samples per pixel along each axis; `None` gives the same pictures as stored frames.
        memory_bytes: Memory for rendered pictures. As many of the first rows as fit are rendered once and kept; the
            others are rendered in each epoch.
        tell: Progress callback, called with labelled and total episodes; may raise to cancel.

    Raises:
        UsageError: The dataset has no episodes, or they were recorded with different rates, cameras or robots.
        ArchiveCorrupt: An episode is damaged.
    """
    steps = label_steps(dataset, size, hold, stops, tell)
    samples = antialias or FRAME_SIZE_PX // size
    return steps.with_pictures(
        dataset, RenderedPictures(dataset, steps, size=size, antialias=samples, memory_bytes=memory_bytes)
    )


class RenderedPictures:
    """`PictureSource` that renders pictures in threads.

    Args:
        dataset: Episodes of the steps.
        steps: Rows of the training.
        size: Side of the pictures, pixels.
        antialias: Samples per pixel along each axis.
        memory_bytes: Memory for the pictures of the first rows.
    """

    def __init__(self, dataset: Dataset, steps: LabelledSteps, size: int, antialias: int, memory_bytes: int) -> None:
        self._episodes, self._steps = OpenEpisodes(dataset), steps
        self._size, self._pixels = size, size * antialias
        row_bytes = sum(image.nbytes for image in Pictures.empty(1, size))
        kept = min(len(steps.step), memory_bytes // row_bytes)
        self._kept, self._is_kept = Pictures.empty(kept, size), np.zeros(kept, np.bool_)
        if dataset.appearance is not None and dataset.appearance.changes_scenes:
            self._render_in_order(kept)

    def _render_in_order(self, count: int) -> None:
        """Renders the first rows episode by episode, because each episode has its own scene, which takes time to
        prepare."""
        rows = np.arange(count, dtype=np.int64)
        for episode in np.unique(self._steps.episode[:count]):
            self.take(rows[self._steps.episode[:count] == episode])

    def take(self, rows: NDArray[np.int64]) -> Pictures:
        """Returns the pictures of these rows; renders those that are not kept.

        Raises:
            WorldError: This machine cannot render; the message has the remedy.
            ArchiveCorrupt: The package of a scene was not found.
        """
        made = Pictures.empty(len(rows), self._size)
        episodes = [self._episodes.take(int(self._steps.episode[row])) for row in rows]
        for_each(lambda place: self._fill(made, place, int(rows[place]), episodes[place]), len(rows))
        self._episodes.trim()
        return made

    def _fill(self, made: Pictures, place: int, row: int, episode: Episode) -> None:
        """Copies or renders the pictures of a row."""
        can_keep = row < len(self._is_kept)
        if can_keep and self._is_kept[row]:
            made.copy_row(place, self._kept, row)
            return
        frame = episode.frame(int(self._steps.step[row]), self._pixels)
        made.put(place, frame, episode.meta.target_instance_id)
        if can_keep:
            self._kept.copy_row(row, made, place)
            self._is_kept[row] = True
