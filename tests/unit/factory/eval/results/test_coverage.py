"""Simulated coverage of the 95 % intervals for 3 to 200 episodes; `-s` prints the table of docs/evaluation."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from numpy.random import Generator

from factory.eval.results.estimate import IntervalEstimate, difference_of_shares, mean_of
from factory.stats.measures import share_of

SIZES = (3, 5, 10, 20, 50, 200)
SAMPLES = 600
"""Samples of a cell; the standard error of a coverage of 95 % is 0.9 %."""
Draw = Callable[[Generator, int], tuple[float, float | None, float | None]]
"""Draws a sample of a number of episodes; returns the true value and the ends of the interval."""


def of(truth: float, found: IntervalEstimate) -> tuple[float, float | None, float | None]:
    return truth, found.low, found.high


def spl_values(rng: Generator, n: int, success: float) -> np.ndarray:
    """Returns values with mean 0.8 x success: 0 for a failure, otherwise uniform from 0.6 to 1."""
    return (rng.random(n) < success) * rng.uniform(0.6, 1.0, n)


def draw_share(rng: Generator, n: int) -> tuple[float, float | None, float | None]:
    rate = rng.random()
    share = share_of(int(rng.binomial(n, rate)), n)
    return rate, share.low, share.high


def draw_spl(rng: Generator, n: int) -> tuple[float, float | None, float | None]:
    success = rng.uniform(0.1, 0.9)
    return of(0.8 * success, mean_of(spl_values(rng, n, success).tolist(), (0.0, 1.0)))


def draw_spl_difference(rng: Generator, n: int) -> tuple[float, float | None, float | None]:
    one, two = rng.uniform(0.1, 0.9, 2)
    values = spl_values(rng, n, two) - spl_values(rng, n, one)
    return of(0.8 * (two - one), mean_of(values.tolist(), (-1.0, 1.0)))


def draw_distance(rng: Generator, n: int) -> tuple[float, float | None, float | None]:
    return of(2.0, mean_of(rng.gamma(4.0, 0.5, n).tolist()))


tango = cache(difference_of_shares)


def draw_pairs(rng: Generator, n: int) -> tuple[float, float | None, float | None]:
    chances = rng.dirichlet((1.0, 1.0, 1.0))
    first, second, _ = rng.multinomial(n, chances).tolist()
    return of(float(chances[1] - chances[0]), tango(first, second, n))


DRAWS: dict[str, tuple[Draw, float, float]] = {
    "share": (draw_share, 94.0, 97.0),
    "spl": (draw_spl, 94.0, 98.5),
    "spl difference": (draw_spl_difference, 94.0, 99.9),
    "distance": (draw_distance, 92.5, 97.0),
    "paired share": (draw_pairs, 94.0, 98.5),
}
"""Name -> draw, and the least and largest mean coverage in per cent that are permitted, over all sizes."""


def coverage(draw: Draw, n: int, samples: int = SAMPLES) -> float:
    """Returns the share of intervals that contain the true value, per cent."""
    rng = np.random.default_rng(n)
    found = [draw(rng, n) for _ in range(samples)]
    hits = [low is not None and high is not None and low - 1e-9 <= truth <= high + 1e-9 for truth, low, high in found]
    return 100.0 * float(np.mean(hits))


@pytest.mark.parametrize("name", DRAWS)
def test_intervals_have_their_nominal_coverage(name: str) -> None:
    draw, least, most = DRAWS[name]
    found = [coverage(draw, n) for n in SIZES]
    print(name, ", ".join(f"{value:.1f}" for value in found))  # noqa: T201
    assert least <= np.mean(found) <= most
    assert min(found) >= 91.0
