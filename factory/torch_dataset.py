"""Every frame of a dataset as a sample for `torch.utils.data.DataLoader`; needs no torch until torch uses it.

Keeps a few bundles open a process; decodes one frame a sample and shuffles nothing.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from factory.dataset import Dataset, Episode

__all__ = ["FrameDataset", "Sample"]

_OPEN_EPISODES = 128
"""Kept open by a process: 0.6 MiB and a file each; to open one again costs as much as a frame."""


class Sample(TypedDict, total=False):
    """One step of one episode; arrays become tensors in torch's default collation."""

    rgb: NDArray[np.uint8]
    """(640, 640, 3)."""
    depth: NDArray[np.float32]
    """(640, 640) metres."""
    ids: NDArray[np.int32]
    """(640, 640) instance ids; only when asked for."""
    instruction: str
    action: NDArray[np.float32]
    """(2,) v in m/s, w in rad/s."""
    tokens: NDArray[np.int64]
    """(2,) 0..6."""
    episode_id: str
    step: int


class FrameDataset:
    """A map-style dataset: `len` frames, indexed over all episodes in order.

    Args:
        dataset: the episodes, filtered as wanted.
        with_ids: whether samples hold the instance ids.
        stride: take every n-th frame of an episode.
    """

    def __init__(self, dataset: Dataset, with_ids: bool = False, stride: int = 1) -> None:
        if stride < 1:
            raise ValueError(f"stride {stride}: at least 1")
        self._dataset = dataset
        self._with_ids = with_ids
        self._stride = stride
        lengths = np.asarray(dataset.metadata["num_steps"].to_pylist(), np.int64)
        self._ends: NDArray[np.int64] = np.cumsum(-(-lengths // stride), dtype=np.int64)
        self._open: OrderedDict[int, Episode] = OrderedDict()

    def __len__(self) -> int:
        return int(self._ends[-1]) if len(self._ends) else 0

    def __getitem__(self, index: int) -> Sample:
        if not -len(self) <= index < len(self):
            raise IndexError(f"{len(self)} frames, asked for number {index}")
        index %= len(self)
        position = int(np.searchsorted(self._ends, index, side="right"))
        first = int(self._ends[position - 1]) if position else 0
        return self._sample(self._episode(position), (index - first) * self._stride)

    def _sample(self, episode: Episode, t: int) -> Sample:
        sample: Sample = {
            "rgb": episode.rgb(t),
            "depth": episode.depth(t).copy(),  # decoded arrays are read-only, which torch warns about
            "instruction": episode.instruction,
            "action": episode.actions[t].copy(),
            "tokens": episode.tokens[t].astype(np.int64),
            "episode_id": episode.episode_id,
            "step": t,
        }
        if self._with_ids:
            sample["ids"] = episode.ids(t).astype(np.int32)
        return sample

    def _episode(self, position: int) -> Episode:
        episode = self._open.pop(position, None) or self._dataset[position]
        self._open[position] = episode
        if len(self._open) > _OPEN_EPISODES:
            self._open.popitem(last=False)[1].close()
        return episode

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_open": OrderedDict()}
