"""Benchmarks reading a dataset: random frames in one process, and a shuffled DataLoader if torch is installed."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from factory.bench.machine import describe_machine, measure_memory, resident_mib
from factory.bench.results import ReadBench, Spread
from factory.dataset.episode import Episode
from factory.dataset.reader import Dataset
from factory.dataset.torch import FrameDataset, collate
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.frame import Frame
from schemas.terms import Recording

_SEED = 20
_BATCH = 16

Look = Callable[[Episode, int], object]
_IMAGES: dict[str, Look] = {"rgb": Episode.rgb, "depth": Episode.depth, "ids": Episode.ids}


def bench_read(
    dataset: Dataset, frames: int, repeats: int, workers: int, size: int = FRAME_SIZE_PX, antialias: int = 1
) -> ReadBench:
    """Reads the same random frames in every repetition, after one warm-up round, and returns the measurements.

    Args:
        dataset: Dataset to read.
        frames: Number of random frames per repetition, from all episodes.
        repeats: Number of timed rounds.
        workers: Number of worker processes of the DataLoader.
        size: Width and height of the frames, pixels.
        antialias: Samples per pixel along each axis.
    """

    def look(episode: Episode, t: int) -> Frame:
        return episode.frame(t, size, antialias)

    def load(workers: int, threads: int | None = None) -> Spread | None:
        if importlib.util.find_spec("torch") is None:
            return None
        source = FrameDataset(dataset, with_ids=True, threads=threads, size=size, antialias=antialias)
        return Spread.of([_load(source, workers, frames) for _ in range(repeats)])

    machine = describe_machine()
    picks = _draw(dataset, frames)
    episodes = {position: dataset[position] for position in {position for position, _ in picks}}
    visits = [(episodes[position], t) for position, t in picks]
    _round(visits, look)
    start_mib = resident_mib()
    whole = [_round(visits, look) for _ in range(repeats)]
    is_rendered = dataset.meta.plan.record is Recording.STATES or (size, antialias) != (FRAME_SIZE_PX, 1)
    images = _IMAGES if (size, antialias) == (FRAME_SIZE_PX, 1) else {}
    return ReadBench(
        machine=machine,
        episodes=len(dataset),
        frames=frames,
        repeats=repeats,
        size=size,
        antialias=antialias,
        random_frames_per_s=Spread.of([frames / wall for wall, _ in whole]),
        random_frames_per_cpu_s=None if is_rendered else Spread.of([frames / cpu for _, cpu in whole]),
        by_image={
            name: Spread.of([frames / _round(visits, read)[0] for _ in range(repeats)]) for name, read in images.items()
        },
        open_ms=Spread.of([1000 * _open(dataset, position) for position in sorted(episodes)]),
        loader_workers=workers,
        one_thread_frames_per_s=load(0, 1),
        loader_frames_per_s=load(workers),
        threads_frames_per_s=load(0),
        memory=measure_memory(start_mib),
    )


def _draw(dataset: Dataset, frames: int) -> list[tuple[int, int]]:
    rng = np.random.default_rng(_SEED)
    lengths = dataset.column("num_steps").to_pylist()
    positions = rng.integers(len(lengths), size=frames)
    return [(int(position), int(rng.integers(lengths[position]))) for position in positions]


def _round(visits: list[tuple[Episode, int]], look: Look) -> tuple[float, float]:
    wall, cpu = time.perf_counter(), time.process_time()
    for episode, t in visits:
        look(episode, t)
    return time.perf_counter() - wall, time.process_time() - cpu


def _open(dataset: Dataset, position: int) -> float:
    start_s = time.perf_counter()
    with dataset[position] as episode:
        _ = episode.actions
    return time.perf_counter() - start_s


def _load(source: FrameDataset, workers: int, frames: int) -> float:
    import torch

    drawn = torch.utils.data.RandomSampler(source, num_samples=min(len(source), frames + _BATCH))
    # the client of an object store does not work after a fork
    context = None if not workers or isinstance(source.dataset.root, Path) else "spawn"
    loader: Any = torch.utils.data.DataLoader(
        source, _BATCH, sampler=drawn, num_workers=workers, multiprocessing_context=context, collate_fn=collate
    )
    seen, start_s = 0, 0.0
    for batch in loader:
        if not seen:
            start_s = time.perf_counter()  # excludes the start of the processes and the first batch
        seen += len(batch["step"])
    return (seen - _BATCH) / (time.perf_counter() - start_s)
