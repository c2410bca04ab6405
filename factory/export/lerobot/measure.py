"""Computes statistics per episode and over all episodes from pieces, in bounded memory."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pyarrow as pa

from factory.export.lerobot.layout import Layout
from factory.export.lerobot.numbering import Numbered, Numbering
from factory.export.lerobot.piece import empty_tally, read_columns, stats_of_images
from factory.export.lerobot.statistics import ImageTally, RunningStats, vector_stats

Stats = dict[str, dict[str, Any]]
"""Feature -> statistic -> values."""


def episode_stats(numbered: Numbered, layout: Layout) -> Stats:
    """Returns the statistics of one episode: feature -> statistic -> values."""
    images = stats_of_images(numbered.piece.facts.images, layout)
    return images | {name: vector_stats(matrix) for name, matrix in _matrices(numbered, layout)}


class DatasetStats:
    """Accumulator of statistics over all episodes: `merge` each episode, then call `result`."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._images: dict[str, ImageTally] = {}
        self._vectors: dict[str, RunningStats] = {}

    def merge(self, numbered: Numbered, stats: Stats) -> None:
        """Adds the statistics of an episode."""
        for image in self._layout.images:
            self._images.setdefault(image.key, empty_tally(image)).merge(numbered.piece.facts.images[image.key])
        for name in self._layout.columns:
            self._vectors.setdefault(name, RunningStats()).merge(stats[name])

    def result(self, numbering: Numbering) -> Stats:
        """Reads the columns again for the quantiles and returns the statistics over all episodes."""
        for numbered in numbering:
            for name, matrix in _matrices(numbered, self._layout):
                self._vectors[name].add(matrix)
        images = stats_of_images({key: tally.result() for key, tally in self._images.items()}, self._layout)
        return images | {name: running.result() for name, running in self._vectors.items()}


def _matrices(numbered: Numbered, layout: Layout) -> Iterator[tuple[str, Any]]:
    """Yields the name and the values (N,) or (N, D) of each column; for scans, the ranges of all frames (N * rays,)."""
    without_pictures = Layout(layout.videos, layout.columns)
    table = read_columns(numbered.piece.folder, numbered.numbers(), without_pictures)
    for name, column in layout.columns.items():
        array = table[name].combine_chunks()
        while not pa.types.is_primitive(array.type):
            array = array.flatten()
        values = array.to_numpy(zero_copy_only=False)
        yield name, values if column.is_scan or not column.shape else values.reshape(-1, *column.shape)
