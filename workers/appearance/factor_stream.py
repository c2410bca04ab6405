"""Random numbers of the appearance, as a function of seed, episode and factor."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import TypeVar

import numpy as np

_STREAM = 22
"""Spawn key that separates the appearance from the streams of jobs and of sensor noise."""
_UNIT = 2.0**-53
Item = TypeVar("Item")


class Factor(IntEnum):
    """Factor with a separate stream; the numbers are part of the bytes of a dataset."""

    LIGHT = 1  # lamp groups and sky
    SURFACES = 2  # walls, floors and ceilings
    FURNITURE = 3  # other objects
    CAMERA = 4  # mounting pose, lens and exposure
    CLUTTER = 5  # small objects


class FactorStream:
    """Stream of one factor of one episode; uses raw bits of PCG64, which numpy keeps in every version (NEP 19)."""

    def __init__(self, seed: int, episode: int, factor: Factor) -> None:
        sequence = np.random.SeedSequence(seed, spawn_key=(_STREAM, episode, int(factor)))
        self._bits = np.random.PCG64(sequence)

    def share(self) -> float:
        """Returns a number in [0, 1)."""
        return (int(self._bits.random_raw()) >> 11) * _UNIT

    def between(self, ends: tuple[float, float], digits: int = 4) -> float:
        """Returns a number of a range, rounded to some decimal places."""
        low, high = ends
        return min(max(round(low + self.share() * (high - low), digits), low), high)

    def below(self, count: int) -> int:
        """Returns a whole number from 0 to `count - 1`."""
        return int(self.share() * count)

    def choose(self, items: Sequence[Item]) -> Item:
        return items[self.below(len(items))]
