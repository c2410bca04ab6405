"""Renders the frames of a states dataset for a training, and keeps them in memory up to a limit. Writes no file."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from factory.dataset.open_episodes import OpenEpisodes
from factory.dataset.reader import Dataset, Episode
from factory.dataset.threads import for_each
from factory.train.frames import LabelledSteps, Pictures, ProgressCallback, TrainingFrames, label_steps
from schemas.encoding.image_sizes import FRAME_SIZE_PX


def render_frames(
    dataset: Dataset, size: int, hold: int, antialias: int | None, memory_bytes: int, tell: ProgressCallback
) -> TrainingFrames:
    """Returns the frames of a dataset's episodes, which are rendered when they are used.

    Args:
        dataset: Episodes that store states.
        size: Side of the pictures, pixels.
        hold: Steps between two selected frames.
        antialias: Samples per pixel along each axis; `None` gives the same pictures as stored frames.
        memory_bytes: Memory for rendered pictures. As many of the first rows as fit are rendered once and kept; the
            others are rendered in each epoch.
        tell: Progress callback, called with labelled and total episodes; may raise to cancel.

    Raises:
        UsageError: The dataset has no episodes, or they were recorded with different rates, cameras or robots.
        ArchiveCorrupt: An episode is damaged.
    """
    steps = label_steps(dataset, size, hold, tell)
    samples = antialias or FRAME_SIZE_PX // size
    return steps.with_pictures(dataset, RenderedPictures(dataset, steps, size, samples, memory_bytes))


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
