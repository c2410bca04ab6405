"""Apportions integer quotas with the Webster (Sainte-Lague) method, and samples the least used option.

The functions have no side effects apart from the counter that `least_used` updates.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from typing import TypeVar

import numpy as np

Key = TypeVar("Key", bound=Hashable)


def webster_sequence(shares: Mapping[Key, float], count: int) -> list[Key]:
    """Returns a sequence of `count` keys in which every prefix is apportioned to the shares.

    The next key is the one with the largest share / (2 * already given + 1); ties go to the first in the mapping.
    Webster's method is house-monotone: in a longer sequence no key has fewer places (Balinski & Young, 1982).
    """
    given = dict.fromkeys(shares, 0)
    sequence = []
    for _ in range(count):
        key = max(given, key=lambda k: shares[k] / (2 * given[k] + 1))
        given[key] += 1
        sequence.append(key)
    return sequence


def apportion(shares: Mapping[Key, float], count: int) -> dict[Key, int]:
    """Returns the quota of each key; the quotas sum to `count`."""
    total = sum(shares.values())
    # starts with quotas below the result of Webster's method, so the loop is short for a large count, too
    given = {key: max(0, int(count * share / total) - len(shares)) for key, share in shares.items()}
    for _ in range(count - sum(given.values())):
        given[max(given, key=lambda k: shares[k] / (2 * given[k] + 1))] += 1
    return given


def least_used(options: Sequence[Key], used: Counter[Key], rng: np.random.Generator) -> Key:
    """Samples uniformly among the least used options and increments the count of the result."""
    fewest = min(used[option] for option in options)
    candidates = [option for option in options if used[option] == fewest]
    choice = candidates[int(rng.integers(len(candidates)))]
    used[choice] += 1
    return choice
