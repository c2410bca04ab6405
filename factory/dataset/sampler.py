"""Order of training samples in which few scenes alternate, so a renderer prepares each scene once per epoch.

With a shuffle over all scenes, nearly every sample would prepare a scene. Reads no files and renders nothing.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from factory.dataset.reader import Dataset
from factory.dataset.rendering import KEPT_SCENES
from factory.dataset.torch import ClipDataset

_BUFFER_SAMPLES = 1 << 22
"""Number of samples that are shuffled at a time; a window with more samples is cut into buffers of whole episodes."""


def scene_numbers(dataset: Dataset) -> NDArray[np.int64]:
    """Returns the number of the scene of each episode, (E,); scenes are numbered in order of first occurrence."""
    column = dataset.column("scene_sha256").cast(pa.string())
    numbers: NDArray[np.int64] = pc.index_in(column, value_set=pc.unique(column)).to_numpy().astype(np.int64)
    return numbers


def shuffle_by_scene(
    scenes: NDArray[np.int64], rng: np.random.Generator, at_once: int = KEPT_SCENES
) -> list[NDArray[np.int64]]:
    """Shuffles items within windows: each window has the positions of all items of at most `at_once` random scenes.

    If there are at most `at_once` scenes in total, the only window is `rng.permutation(len(scenes))`.

    Args:
        scenes: (N,) number of the scene of each item, 0, 1, ...
        rng: random generator.
        at_once: largest number of scenes in a window.
    """
    order = rng.permutation(len(scenes))
    count = int(scenes.max(initial=-1)) + 1
    if count <= at_once:
        return [order]
    window = (rng.permutation(count) // at_once)[scenes[order]]
    by_window = np.argsort(window, kind="stable")
    return np.split(order[by_window], np.flatnonzero(np.diff(window[by_window])) + 1)


class SceneSampler:
    """Sampler for PyTorch's `DataLoader` that shuffles within windows of a few scenes.

    In each epoch, the scenes are divided at random into windows of `scenes` scenes; the samples of a window are
    shuffled. A dataset with at most `scenes` scenes is shuffled as a whole. Each rank of a distributed training gets a
    contiguous part of the order, so every sample is used exactly once in an epoch; the numbers of samples of two
    ranks differ by at most one.

    Args:
        samples: Dataset of frames or clips.
        scenes: Number of scenes that alternate.
        seed: Random seed; the order depends on seed, epoch and dataset only.
        rank: Number of this process in a distributed training, from 0.
        replicas: Number of processes of a distributed training.
        even: Whether all ranks get the same number of samples. If so, up to `replicas - 1` samples of an epoch are
            omitted.
    """

    def __init__(
        self,
        samples: ClipDataset,
        scenes: int = KEPT_SCENES,
        seed: int = 0,
        rank: int = 0,
        replicas: int = 1,
        even: bool = False,
    ) -> None:
        if scenes < 1:
            raise ValueError(f"scenes {scenes}: must be at least 1")
        if not 0 <= rank < replicas:
            raise ValueError(f"rank {rank} with replicas {replicas}: choose 0 to {replicas - 1}")
        self._counts, self._firsts = samples.counts, np.cumsum(samples.counts) - samples.counts
        self._scenes = scene_numbers(samples.dataset)
        self._at_once, self._seed = scenes, seed
        total = len(samples) - len(samples) % replicas if even else len(samples)
        self._begin, self._end = total * rank // replicas, total * (rank + 1) // replicas
        self._epoch = self._done = 0

    def set_epoch(self, epoch: int, done: int = 0) -> None:
        """Selects the order of an epoch.

        Args:
            epoch: Number of the epoch, from 0.
            done: Number of samples of this rank that are skipped at the beginning, to resume a training; the number
                of finished batches times the batch size.
        """
        self._epoch, self._done = epoch, done

    def __len__(self) -> int:
        return max(0, self._end - self._begin - self._done)

    def __iter__(self) -> Iterator[int]:
        """Yields the indices of this rank's samples."""
        begin, start = self._begin + self._done, 0
        for number, episodes in enumerate(self._buffers()):
            count = int(self._counts[episodes].sum())
            here = slice(max(0, begin - start), max(0, self._end - start))
            start += count
            if here.start < min(here.stop, count):
                rng = np.random.default_rng((self._seed, self._epoch, number))
                yield from rng.permutation(self._samples_of(episodes))[here].tolist()

    def _buffers(self) -> Iterator[NDArray[np.int64]]:
        """Yields the episodes whose samples are shuffled together."""
        rng = np.random.default_rng((self._seed, self._epoch))
        for window in shuffle_by_scene(self._scenes, rng, self._at_once):
            ends = np.cumsum(self._counts[window])
            yield from np.split(window, np.flatnonzero(np.diff(ends // _BUFFER_SAMPLES)) + 1)

    def _samples_of(self, episodes: NDArray[np.int64]) -> NDArray[np.int64]:
        """Returns the indices of all samples of some episodes."""
        counts = self._counts[episodes]
        before = np.cumsum(counts) - counts
        return np.repeat(self._firsts[episodes] - before, counts) + np.arange(counts.sum())
