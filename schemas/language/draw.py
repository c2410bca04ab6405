"""Draws items by weights. The random generator is an argument."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import TypeVar

import numpy as np

Option = TypeVar("Option", bound=str)


def draw_index(weights: Sequence[float], rng: np.random.Generator) -> int:
    if len(weights) == 1:
        return 0
    edges = list(accumulate(weights))
    return min(bisect_right(edges, rng.random() * edges[-1]), len(weights) - 1)


def draw_weighted(shares: Mapping[Option, float], rng: np.random.Generator) -> Option:
    names = list(shares)
    return names[draw_index([shares[name] for name in names], rng)]
