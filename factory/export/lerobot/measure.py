"""Computes statistics per episode and over all episodes from pieces, in bounded memory."""

from __future__ import annotations

from typing import Any

import pyarrow as pa

from factory.export.lerobot.features import VECTORS, LeRobotOptions
from factory.export.lerobot.numbering import Numbered, Numbering
from factory.export.lerobot.piece import empty_tally, read_columns, stats_of_images
from factory.export.lerobot.statistics import ImageTally, RunningStats, vector_stats

Stats = dict[str, dict[str, Any]]
"""Feature -> statistic -> values."""


def episode_stats(numbered: Numbered, options: LeRobotOptions, far_m: float) -> Stats:
    """Returns the statistics of one episode: feature -> statistic -> values."""
    table = _vectors(numbered, options)
    images = stats_of_images(numbered.piece.facts.images, far_m)
    return images | {name: vector_stats(_matrix(table[name])) for name in VECTORS}


class DatasetStats:
    """Accumulator of statistics over all episodes: `merge` each episode, then call `result`."""

    def __init__(self, far_m: float) -> None:
        self._far_m = far_m
        self._images: dict[str, ImageTally] = {}
        self._vectors: dict[str, RunningStats] = {}

    def merge(self, numbered: Numbered, stats: Stats) -> None:
        """Adds the statistics of an episode."""
        for key, counts in numbered.piece.facts.images.items():
            self._images.setdefault(key, empty_tally(key)).merge(counts)
        for name in VECTORS:
            self._vectors.setdefault(name, RunningStats()).merge(stats[name])

    def result(self, numbering: Numbering, options: LeRobotOptions) -> Stats:
        """Reads the columns again for the quantiles and returns the statistics over all episodes."""
        for numbered in numbering:
            table = _vectors(numbered, options)
            for name, running in self._vectors.items():
                running.add(_matrix(table[name]))
        images = stats_of_images({key: tally.result() for key, tally in self._images.items()}, self._far_m)
        return images | {name: running.result() for name, running in self._vectors.items()}


def _vectors(numbered: Numbered, options: LeRobotOptions) -> pa.Table:
    without_pictures = options.model_copy(update={"ids": False})
    return read_columns(numbered.piece.folder, numbered.numbers(), without_pictures)


def _matrix(column: pa.ChunkedArray) -> Any:
    array = column.combine_chunks()
    if pa.types.is_fixed_size_list(array.type):
        return array.flatten().to_numpy(zero_copy_only=False).reshape(len(array), -1)
    return array.to_numpy(zero_copy_only=False)
