"""Map-style PyTorch datasets with one sample for each frame or clip. Imports torch only in `collate`.

Does not shuffle. Threads decode or render the frames of a batch directly into the batch arrays, because copying an
image between processes costs more than decoding it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypedDict, cast

import numpy as np
from numpy.typing import NDArray

from factory.dataset.parallel import OpenEpisodes, for_each
from factory.dataset.reader import Dataset, Episode
from schemas.encoding.image_sizes import FRAME_SIZE_PX, MAX_SIZE_PX
from schemas.support.extras import require_package


class Sample(TypedDict, total=False):
    """Sample of one step; torch's default collation converts the arrays to tensors.

    The arrays of a clip of K frames have K as their first axis, and `step` is an array, (K,).
    """

    rgb: NDArray[np.uint8]
    """(size, size, 3) sRGB."""
    depth: NDArray[np.float32]
    """(size, size) depth, metres."""
    ids: NDArray[np.int32]
    """(size, size) instance ids; present only with `with_ids`."""
    instruction: str
    action: NDArray[np.float32]
    """(2,) action: v in m/s, w in rad/s."""
    tokens: NDArray[np.int64]
    """(2,) action tokens, 0..6."""
    episode_id: str
    step: int | NDArray[np.int64]


class FrameBatch(list[Sample]):
    """List of samples whose images share contiguous arrays, which `collate` uses without a copy."""

    def __init__(self, samples: Sequence[Sample], images: dict[str, NDArray[Any]]) -> None:
        super().__init__(samples)
        self.images = images
        """Batch arrays by field name of `Sample`, (N, ...); each sample has a view of one element."""


class ClipDataset:
    """Map-style dataset of clips: `length` frames of one episode, indexed over all episodes in order.

    Clips are never padded: an episode that is shorter than a clip has no sample. Loading is fastest with `collate` and
    without worker processes, `DataLoader(clips, 16, sampler=SceneSampler(clips), collate_fn=collate)`: threads decode
    or render a batch on all cores.

    Frames of 640 pixels without antialiasing are those of the recording. Frames of other sizes are rendered, whether
    the episode stores frames or states, so both recordings give equal samples (docs/dataset.md#recordings).

    Args:
        dataset: Episodes to read; filter it first if needed.
        length: Frames of a clip.
        stride: Steps from one frame of a clip to the next.
        every: Steps from the start of a clip to the start of the next one.
        with_ids: Whether samples contain the instance ids.
        size: Width and height of the images, pixels.
        antialias: Samples per pixel along each axis. The colour of a pixel is their mean, depth and id are those of the
            middle sample.
        threads: Threads that read a batch. Default: one per core, or one in a worker process.
    """

    _noun = "clips"

    def __init__(
        self,
        dataset: Dataset,
        length: int,
        stride: int = 1,
        every: int = 1,
        *,
        with_ids: bool = False,
        size: int = FRAME_SIZE_PX,
        antialias: int = 1,
        threads: int | None = None,
    ) -> None:
        numbers = {"length": length, "stride": stride, "every": every, "size": size, "antialias": antialias}
        for name, value in {**numbers, "threads": threads}.items():
            if value is not None and value < 1:
                raise ValueError(f"{name} {value}: must be at least 1")
        if size * antialias > MAX_SIZE_PX:
            raise ValueError(f"size {size} with antialias {antialias}: their product must be at most {MAX_SIZE_PX}")
        self.dataset = dataset
        """Episodes of the samples."""
        self._length, self._stride, self._every = length, stride, every
        self._size, self._antialias, self._with_ids, self._threads = size, antialias, with_ids, threads
        steps = np.asarray(dataset.column("num_steps").to_pylist(), np.int64)
        self.counts: NDArray[np.int64] = np.maximum(0, (steps - (length - 1) * stride - 1) // every + 1)
        """(E,) number of samples of each episode; the samples of an episode are contiguous."""
        self._ends: NDArray[np.int64] = np.cumsum(self.counts, dtype=np.int64)
        self._episodes = OpenEpisodes(dataset)

    def __len__(self) -> int:
        return int(self._ends[-1]) if len(self._ends) else 0

    def __getitem__(self, index: int) -> Sample:
        return self.__getitems__([index])[0]

    def __getitems__(self, indices: Sequence[int]) -> FrameBatch:
        """Returns the samples of a batch; PyTorch calls this method with all indices of the batch."""
        places = [self._find(index) for index in indices]
        images = self._allocate(len(places))
        self._read_images(places, images)
        samples = [
            self._sample(episode, first, {name: batch[number] for name, batch in images.items()})
            for number, (episode, first) in enumerate(places)
        ]
        self._episodes.trim()  # episodes are not closed earlier, because the batch uses them
        return FrameBatch(samples, images)

    def _allocate(self, count: int) -> dict[str, NDArray[Any]]:
        shape = count, self._length, self._size, self._size
        images: dict[str, NDArray[Any]] = {"rgb": np.empty((*shape, 3), np.uint8), "depth": np.empty(shape, np.float32)}
        return {**images, "ids": np.empty(shape, np.int32)} if self._with_ids else images

    def _read_images(self, places: Sequence[tuple[Episode, int]], images: dict[str, NDArray[Any]]) -> None:
        """Reads the frames of the clips into the arrays, (N, length, ...)."""
        is_stored = (self._size, self._antialias) == (FRAME_SIZE_PX, 1)

        def fill(number: int) -> None:
            clip, k = divmod(number, self._length)
            episode, t = places[clip][0], places[clip][1] + k * self._stride
            frame = None if is_stored else episode.frame(t, self._size, self._antialias)
            for name, batch in images.items():
                batch[clip, k] = getattr(episode, name)(t) if frame is None else getattr(frame, name)

        for_each(fill, len(places) * self._length, self._threads)

    def _sample(self, episode: Episode, first: int, images: dict[str, NDArray[Any]]) -> Sample:
        steps = first + self._stride * np.arange(self._length)
        rest: Sample = {
            "instruction": episode.instruction,
            "action": episode.actions[steps],
            "tokens": episode.tokens[steps].astype(np.int64),
            "episode_id": episode.episode_id,
            "step": steps,
        }
        return {**images, **rest}  # type: ignore[typeddict-item]

    def _find(self, index: int) -> tuple[Episode, int]:
        """Returns the episode and the first step of a sample."""
        if not -len(self) <= index < len(self):
            raise IndexError(f"index {index} is out of range for {len(self)} {self._noun}")
        index %= len(self)
        position = int(np.searchsorted(self._ends, index, side="right"))
        first = int(self._ends[position] - self.counts[position])
        return self._episodes.take(position), (index - first) * self._every


class FrameDataset(ClipDataset):
    """Map-style dataset of frames: clips of one frame, without their first axis.

    Args:
        dataset: Episodes to read; filter it first if needed.
        with_ids: Whether samples contain the instance ids.
        stride: Use every n-th frame of an episode.
        threads: Threads that read a batch. Default: one per core, or one in a worker process.
        size: Width and height of the images, pixels; see `ClipDataset`.
        antialias: Samples per pixel along each axis; see `ClipDataset`.
    """

    _noun = "frames"

    def __init__(
        self,
        dataset: Dataset,
        with_ids: bool = False,
        stride: int = 1,
        threads: int | None = None,
        *,
        size: int = FRAME_SIZE_PX,
        antialias: int = 1,
    ) -> None:
        if stride < 1:
            raise ValueError(f"stride {stride}: must be at least 1")
        super().__init__(dataset, 1, every=stride, with_ids=with_ids, size=size, antialias=antialias, threads=threads)

    def __getitems__(self, indices: Sequence[int]) -> FrameBatch:
        """Returns the samples of a batch; PyTorch calls this method with all indices of the batch."""
        clips = super().__getitems__(indices)
        return FrameBatch(list(map(_single, clips)), {name: batch[:, 0] for name, batch in clips.images.items()})


def _single(clip: Sample) -> Sample:
    """Returns a clip of one frame without its first axis."""
    frame = {name: value if isinstance(value, str) else value[0] for name, value in clip.items()}  # type: ignore[index]
    return cast(Sample, {**frame, "step": int(frame["step"])})


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
