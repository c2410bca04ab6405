"""Keeps the most recently used episodes of a dataset open. Reads no frames."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

from factory.dataset.reader import Dataset, Episode

MOST_OPEN = 128
"""Maximum number of open bundles; one takes 0.6 MiB and an open file. Opening it takes as long as decoding a frame."""


class OpenEpisodes:
    """Episodes of a dataset by position; a pickled copy has no open episodes."""

    def __init__(self, dataset: Dataset) -> None:
        self.dataset = dataset
        self._open: OrderedDict[int, Episode] = OrderedDict()

    def take(self, position: int) -> Episode:
        """Returns the episode at a position; it stays open until `trim`. Not to be called by several threads."""
        episode = self._open.pop(position, None) or self.dataset[position]
        self._open[position] = episode
        return episode

    def trim(self) -> None:
        """Closes the least recently used episodes, so `MOST_OPEN` remain."""
        while len(self._open) > MOST_OPEN:
            self._open.popitem(last=False)[1].close()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_open": OrderedDict()}
