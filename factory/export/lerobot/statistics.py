"""Computes statistics of features in the format of LeRobot, per episode and over all episodes. Pure functions.

Quantiles of images are computed from histograms. Quantiles of the dataset are computed from all values; LeRobot
averages the quantiles of the episodes instead.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.base import Model

Stats = dict[str, Any]
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
_BINS = 4096
_FEWEST, _MOST, _POWER = 100, 10_000, 0.75
"""Parameters of the sample, as in LeRobot (`estimate_num_samples` in lerobot/datasets/compute_stats.py)."""


def sampled_frames(frames: int) -> frozenset[int]:
    """Returns the frames that image statistics sample: about N^0.75, evenly spaced; at least 100, or all if there are
    fewer; at most 10,000."""
    wanted = max(min(frames, _FEWEST), min(int(frames**_POWER), _MOST))
    return frozenset(np.round(np.linspace(0, frames - 1, wanted)).astype(int).tolist())


def vector_stats(values: NDArray[np.generic]) -> Stats:
    """Returns the statistics of numbers (N,) or (N, D) per column, as lists."""
    table = np.asarray(values, np.float64).reshape(len(values), -1)
    stats: Stats = {
        "min": table.min(axis=0).tolist(),
        "max": table.max(axis=0).tolist(),
        "mean": table.mean(axis=0).tolist(),
        "std": table.std(axis=0).tolist(),
        "count": [len(table)],
    }
    quantiles = np.quantile(table, list(QUANTILES.values()), axis=0)
    return stats | {name: row.tolist() for name, row in zip(QUANTILES, quantiles, strict=True)}


class ImageCounts(Model):
    """Histogram of each channel over the sampled frames; the statistics are computed from it."""

    samples: int
    """Number of sampled frames."""
    values: tuple[int, ...]
    """Codes that occur, ascending."""
    counts: tuple[tuple[int, ...], ...]
    """Per channel, the number of occurrences of each value."""


@dataclass
class ImageTally:
    """Accumulator of image histograms, over frames or episodes."""

    channels: int
    largest: int
    """Maximum code."""
    samples: int = 0
    counts: NDArray[np.int64] = field(init=False)

    def __post_init__(self) -> None:
        self.counts = np.zeros((self.channels, self.largest + 1), np.int64)

    def add(self, image: NDArray[np.generic]) -> None:
        """Adds an image (H, W) or (H, W, C) of unsigned codes."""
        planes = image.reshape(-1, self.channels)
        for channel in range(self.channels):
            self.counts[channel] += np.bincount(planes[:, channel], minlength=self.largest + 1)
        self.samples += 1

    def merge(self, other: ImageCounts) -> None:
        self.counts[:, list(other.values)] += np.asarray(other.counts, np.int64)
        self.samples += other.samples

    def result(self) -> ImageCounts:
        seen = np.flatnonzero(self.counts.any(axis=0))
        counts = tuple(tuple(row[seen].tolist()) for row in self.counts)
        return ImageCounts(samples=self.samples, values=tuple(seen.tolist()), counts=counts)


def image_stats(counts: ImageCounts, decode: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Stats:
    """Returns the statistics of an image feature as lists of shape (C, 1, 1), except `count`.

    Args:
        counts: histogram of the codes.
        decode: monotonic function from codes to the unit of the feature.
    """
    values = decode(np.asarray(counts.values, np.float64))
    columns = [_weighted_stats(values, np.asarray(row, np.float64)) for row in counts.counts]
    stats: Stats = {name: [[[column[name]]] for column in columns] for name in columns[0]}
    return {**stats, "count": [counts.samples]}


def _weighted_stats(values: NDArray[np.float64], counts: NDArray[np.float64]) -> dict[str, float]:
    values, counts = values[counts > 0], counts[counts > 0]
    total = counts.sum()
    mean = float((values * counts).sum() / total)
    rising = np.cumsum(counts) / total
    places = np.minimum(np.searchsorted(rising, list(QUANTILES.values())), len(values) - 1)
    return {
        "min": float(values[0]),
        "max": float(values[-1]),
        "mean": mean,
        "std": math.sqrt(float(((values - mean) ** 2 * counts).sum() / total)),
        **{name: float(values[place]) for name, place in zip(QUANTILES, places, strict=True)},
    }


class RunningStats:
    """Accumulator of the statistics of a column in two passes: `merge` all episodes, then `add` the values of all.

    Memory is bounded. Quantiles are exact to the width of a bin, 1/4096 of the range.
    """

    def __init__(self) -> None:
        self._low: NDArray[np.float64] | None = None
        self._bins: NDArray[np.int64] | None = None

    def merge(self, stats: Mapping[str, Any]) -> None:
        """Adds minimum, maximum, mean and deviation of an episode (Chan's parallel formula)."""
        low, high = np.asarray(stats["min"], np.float64), np.asarray(stats["max"], np.float64)
        mean, count = np.asarray(stats["mean"], np.float64), int(stats["count"][0])
        spread = np.asarray(stats["std"], np.float64) ** 2 * count
        if self._low is None:
            self._low, self._high, self._mean, self._spread, self._count = low, high, mean, spread, count
            return
        total = self._count + count
        step = mean - self._mean
        self._mean = self._mean + step * (count / total)
        self._spread = self._spread + spread + step**2 * (self._count * count / total)
        self._low, self._high, self._count = np.minimum(self._low, low), np.maximum(self._high, high), total

    def add(self, values: NDArray[np.generic]) -> None:
        """Adds the values (N,) or (N, D) of an episode to the histogram of the quantiles; call after all merges."""
        table = np.asarray(values, np.float64).reshape(len(values), -1)
        assert self._low is not None, "nothing merged yet"
        if self._bins is None:
            self._bins = np.zeros((table.shape[1], _BINS), np.int64)
        width = np.maximum(self._high - self._low, np.finfo(np.float64).tiny)
        places = np.clip(((table - self._low) / width * _BINS).astype(np.int64), 0, _BINS - 1)
        for column in range(table.shape[1]):
            self._bins[column] += np.bincount(places[:, column], minlength=_BINS)

    def result(self) -> Stats:
        assert self._low is not None, "nothing merged yet"
        assert self._bins is not None, "nothing added yet"
        rising = np.cumsum(self._bins, axis=1) / self._count
        width = (self._high - self._low) / _BINS
        stats: Stats = {
            "min": self._low.tolist(),
            "max": self._high.tolist(),
            "mean": self._mean.tolist(),
            "std": np.sqrt(self._spread / self._count).tolist(),
            "count": [self._count],
        }
        for name, share in QUANTILES.items():
            places = np.minimum((rising < share).sum(axis=1), _BINS - 1)
            stats[name] = np.minimum(self._low + (places + 0.5) * width, self._high).tolist()
        return stats
