"""Map-style PyTorch dataset with one sample for each frame. Imports torch only in `collate`.

Keeps up to `_OPEN_EPISODES` bundles open in each process; does not shuffle. Threads decode the frames of a batch
directly into the batch arrays: PNG, zstandard and numpy release the GIL, and copying an image between processes costs
more than decoding it.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import parent_process
from typing import Any, TypedDict, cast

import numpy as np
from numpy.typing import NDArray

from factory.dataset.reader import Dataset, Episode
from schemas.encoding.arrays import FRAME_SIZE_PX
from schemas.support.extras import require_package

_OPEN_EPISODES = 128
"""Bundles that a process keeps open, 0.6 MiB and one file each; opening one costs as much as decoding a frame."""
_IMAGE = (FRAME_SIZE_PX, FRAME_SIZE_PX)


class Sample(TypedDict, total=False):
    """Sample of one step; torch's default collation converts the arrays to tensors."""

    rgb: NDArray[np.uint8]
    """(640, 640, 3) sRGB."""
    depth: NDArray[np.float32]
    """(640, 640) depth, metres."""
    ids: NDArray[np.int32]
    """(640, 640) instance ids; present only with `with_ids`."""
    instruction: str
    action: NDArray[np.float32]
    """(2,) action: v in m/s, w in rad/s."""
    tokens: NDArray[np.int64]
    """(2,) action tokens, 0..6."""
    episode_id: str
    step: int


class FrameBatch(list[Sample]):
    """List of samples whose images share contiguous arrays, which `collate` uses without a copy."""

    def __init__(self, samples: Sequence[Sample], images: dict[str, NDArray[Any]]) -> None:
        super().__init__(samples)
        self.images = images
        """Batch arrays by field name of `Sample`, (N, 640, 640, ...); each sample holds a view of one element."""


class FrameDataset:
    """Map-style dataset of frames, indexed over all episodes in order.

    Decoding is fastest with `collate` and without worker processes,
    `DataLoader(frames, 16, shuffle=True, collate_fn=collate)`: threads decode a batch on all cores.

    Args:
        dataset: Episodes to read; filter it first if needed.
        with_ids: Whether samples contain the instance ids.
        stride: Use every n-th frame of an episode.
        threads: Threads that decode a batch. Default: one per core, or one in a worker process.
    """

    def __init__(self, dataset: Dataset, with_ids: bool = False, stride: int = 1, threads: int | None = None) -> None:
        if stride < 1:
            raise ValueError(f"stride {stride}: must be at least 1")
        if threads is not None and threads < 1:
            raise ValueError(f"threads {threads}: must be at least 1")
        self._dataset = dataset
        self._with_ids = with_ids
        self._stride = stride
        self._threads = threads
        lengths = np.asarray(dataset.metadata["num_steps"].to_pylist(), np.int64)
        self._ends: NDArray[np.int64] = np.cumsum(-(-lengths // stride), dtype=np.int64)
        self._open: OrderedDict[int, Episode] = OrderedDict()

    def __len__(self) -> int:
        return int(self._ends[-1]) if len(self._ends) else 0

    def __getitem__(self, index: int) -> Sample:
        return self.__getitems__([index])[0]

    def __getitems__(self, indices: Sequence[int]) -> FrameBatch:
        """Returns the samples of a batch; PyTorch calls this method with all indices of the batch."""
        steps = [self._find(index) for index in indices]
        images: dict[str, NDArray[Any]] = {
            "rgb": np.empty((len(steps), *_IMAGE, 3), np.uint8),
            "depth": np.empty((len(steps), *_IMAGE), np.float32),
        }
        if self._with_ids:
            images["ids"] = np.empty((len(steps), *_IMAGE), np.int32)

        def fill(number: int) -> Sample:
            episode, t = steps[number]
            for name, batch in images.items():
                batch[number] = getattr(episode, name)(t)
            rest = _beside_images(episode, t)
            return {**{name: batch[number] for name, batch in images.items()}, **rest}  # type: ignore[typeddict-item]

        threads = min(len(steps), self._threads or _usable_cores())
        samples = list(map(fill, range(len(steps))) if threads < 2 else _pool(threads).map(fill, range(len(steps))))
        while len(self._open) > _OPEN_EPISODES:  # closed only after decoding, because the batch uses them
            self._open.popitem(last=False)[1].close()
        return FrameBatch(samples, images)

    def _find(self, index: int) -> tuple[Episode, int]:
        if not -len(self) <= index < len(self):
            raise IndexError(f"index {index} is out of range for {len(self)} frames")
        index %= len(self)
        position = int(np.searchsorted(self._ends, index, side="right"))
        first = int(self._ends[position - 1]) if position else 0
        episode = self._open.pop(position, None) or self._dataset[position]
        self._open[position] = episode
        return episode, (index - first) * self._stride

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_open": OrderedDict()}


def collate(samples: Sequence[Sample]) -> dict[str, Any]:
    """Collates a batch as PyTorch's default collation does, but does not copy the images of a `FrameBatch`.

    Raises:
        UsageError: PyTorch is not installed; the message names the extra.
    """
    require_package("torch", "collate of factory.dataset.torch")
    import torch

    if not isinstance(samples, FrameBatch):  # samples of several datasets, joined by `ConcatDataset`
        return cast(dict[str, Any], torch.utils.data.default_collate(samples))
    rest = [{name: value for name, value in sample.items() if name not in samples.images} for sample in samples]
    images = {name: torch.from_numpy(batch) for name, batch in samples.images.items()}
    return {**images, **torch.utils.data.default_collate(rest)}


def _beside_images(episode: Episode, t: int) -> Sample:
    return {
        "instruction": episode.instruction,
        "action": episode.actions[t].copy(),
        "tokens": episode.tokens[t].astype(np.int64),
        "episode_id": episode.episode_id,
        "step": t,
    }


def _usable_cores() -> int:
    return 1 if parent_process() is not None else len(os.sched_getaffinity(0))


_pools: dict[tuple[int, int], ThreadPoolExecutor] = {}


def _pool(threads: int) -> ThreadPoolExecutor:
    """Returns the thread pool of this process; a forked process creates a new one, because it has no threads."""
    key = (os.getpid(), threads)
    if key not in _pools:
        _pools[key] = ThreadPoolExecutor(threads, "decode")
    return _pools[key]
