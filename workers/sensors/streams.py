"""Random numbers of sensor noise, as a function of seed, episode, sensor, effect and step.

Draws raw bits of Philox and maps them itself: numpy keeps the bits of a bit generator in every version, but may change
how a distribution uses them (NEP 19). Draws nothing from a global generator.
"""

from __future__ import annotations

import functools
import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from schemas.support.numpy_types import Bools, Singles

LEVELS = 1 << 16
"""Number of different values that a random number can have."""
_NOISE_STREAM = 21
"""Spawn key that separates sensor noise from the streams of jobs."""


class Effect(IntEnum):
    """Cause of noise with a separate stream; the numbers are part of the bytes of a dataset."""

    DISPARITY = 1  # noise of the disparity
    SHIFT = 2  # lateral displacement of a pixel
    EDGE_DROPOUT = 3  # missing depth at edges
    HOLES = 4  # missing depth in regions
    ELECTRONS = 5  # shot noise and read noise
    EXPOSURE = 6  # exposure of an episode
    WHITE_BALANCE = 7  # white balance of an episode
    RANGE = 8  # noise of a range
    RAY_DROPOUT = 9  # missing ranges
    IMU_START = 10  # bias at the start of an episode
    IMU_STEPS = 11  # white noise and random walk
    WHEEL_RADIUS = 12  # radii of an episode
    WHEEL_SLIP = 13  # slip


@dataclass(frozen=True)
class NoiseKey:
    """Identity of a sensor in an episode, which determines all of its noise."""

    seed: int
    """Root seed of the noise, at least 0."""
    episode: int
    """Number of the episode, at least 0."""
    sensor: str
    """Name of the sensor in its rig."""

    def bits(self, effect: Effect, shape: int | tuple[int, ...], step: int = 0) -> NDArray[np.uint16]:
        """Returns random numbers, uniform in 0..65535.

        The counter of Philox contains effect and step, so each pair has separate numbers, and steps can be read
        in any order (J. K. Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011). The first numbers do
        not depend on the shape.

        Args:
            effect: cause of the noise.
            shape: shape of the result.
            step: control step of the measurement; 0 for noise of a whole episode.
        """
        return self.stream(effect, step)(shape)

    def stream(self, effect: Effect, step: int = 0) -> Callable[[int | tuple[int, ...]], NDArray[np.uint16]]:
        """Returns a function `draw(shape)`; successive calls return successive parts of the sequence of `bits`.

        The size of each part except the last must be a multiple of 4.
        """
        philox = np.random.Philox(key=_philox_key(self), counter=(0, 0, int(effect), step))

        def draw(shape: int | tuple[int, ...]) -> NDArray[np.uint16]:
            count = math.prod(shape) if isinstance(shape, tuple) else shape
            words = philox.random_raw(-(-count // 4))
            return words.astype("<u8", copy=False).view("<u2")[:count].reshape(shape)

        return draw

    def normals(self, effect: Effect, shape: int | tuple[int, ...], step: int = 0) -> Singles:
        """Returns random numbers of the standard normal distribution, see `normal_of` and `bits`."""
        return normal_of(self.bits(effect, shape, step))

    def is_below(self, share: float, effect: Effect, shape: int | tuple[int, ...], step: int = 0) -> Bools:
        """Returns values that are true with the probability `share`, in steps of 1 / 65536; see `bits`."""
        return np.asarray(self.bits(effect, shape, step) < round(share * LEVELS))


@functools.lru_cache(maxsize=256)
def _philox_key(key: NoiseKey) -> NDArray[np.uint64]:
    name = int.from_bytes(hashlib.sha256(key.sensor.encode()).digest()[:8], "little")
    sequence = np.random.SeedSequence(key.seed, spawn_key=(_NOISE_STREAM, key.episode, name))
    return sequence.generate_state(2, np.uint64).astype(np.uint64, copy=False)


def normal_of(bits: NDArray[np.uint16]) -> Singles:
    """Returns standard normal values for uniform 16-bit numbers of any shape.

    The value of number i is the quantile (i + 0.5) / 65536, divided by the standard deviation of all quantiles: mean 0,
    variance 1, and no value beyond 4.4.
    """
    return _quantiles(LEVELS).take(bits)


@functools.cache
def _quantiles(count: int) -> Singles:
    """Returns (count,) equally probable values of a distribution that is close to the normal one, in ascending
    order."""
    upper = np.array([NormalDist().inv_cdf(0.5 + (i + 0.5) / count) for i in range(count // 2)])
    upper /= math.sqrt(math.fsum(upper * upper) / len(upper))
    return np.concatenate((-upper[::-1], upper)).astype(np.float32)
