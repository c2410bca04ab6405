"""Random numbers of sensor noise: distribution, and dependence on seed, episode, sensor, effect and step only."""

from __future__ import annotations

import hashlib
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

from workers.sensors.streams import LEVELS, Effect, NoiseKey, normal_of

KEY = NoiseKey(7, 3, "front")


def digest(step: int) -> str:
    return hashlib.sha256(KEY.bits(Effect.RANGE, 1000, step).tobytes()).hexdigest()


def test_numbers_are_those_of_philox_for_a_seed_sequence_of_seed_episode_and_sensor() -> None:
    """The bytes of a dataset depend on these numbers, so they must never change; numpy guarantees the bits."""
    assert KEY.bits(Effect.RANGE, 4, step=5).tolist() == [52057, 50507, 822, 29242]


@pytest.mark.parametrize(
    "other",
    [NoiseKey(8, 3, "front"), NoiseKey(7, 4, "front"), NoiseKey(7, 3, "rear")],
    ids=["seed", "episode", "sensor"],
)
def test_each_part_of_the_key_gives_other_numbers(other: NoiseKey) -> None:
    assert np.mean(KEY.bits(Effect.RANGE, 4000) == other.bits(Effect.RANGE, 4000)) < 0.01


def test_each_effect_and_each_step_has_different_numbers() -> None:
    drawn = np.array([KEY.bits(effect, 400, step) for effect in Effect for step in (0, 1, 2)])
    assert len(np.unique(drawn, axis=0)) == len(drawn)
    assert np.abs(np.corrcoef(drawn) - np.eye(len(drawn))).max() < 0.3


def test_first_numbers_do_not_depend_on_how_many_are_drawn() -> None:
    assert (KEY.bits(Effect.HOLES, 9) == KEY.bits(Effect.HOLES, (10, 10)).ravel()[:9]).all()


def test_numbers_are_the_same_in_any_order_and_in_other_processes() -> None:
    steps = [5, 0, 3, 9, 1]
    here = {step: digest(step) for step in sorted(steps)}
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        there = dict(zip(steps, pool.map(digest, steps), strict=True))
    assert there == here


def test_normal_values_have_mean_0_variance_1_and_the_kurtosis_of_the_normal_distribution() -> None:
    values = normal_of(np.arange(LEVELS, dtype=np.uint16)).astype(np.float64)
    assert abs(values.mean()) < 1e-9
    assert values.var() == pytest.approx(1, abs=1e-6)
    assert (values**4).mean() == pytest.approx(3, abs=0.01)
    assert (np.diff(values) > 0).all()
    assert np.abs(values).max() < 4.4


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 1.0])
def test_is_below_is_true_for_the_given_share_of_values(share: float) -> None:
    count = 200_000
    found = KEY.is_below(share, Effect.RAY_DROPOUT, count).mean()
    assert found == pytest.approx(share, abs=4 * np.sqrt(share * (1 - share) / count) + 1 / LEVELS)


def test_numbers_drawn_in_parts_are_those_drawn_at_once() -> None:
    draw = KEY.stream(Effect.RANGE, 3)
    parts = [draw((2, 6)).ravel(), draw(8), draw(5)]
    assert np.concatenate(parts).tolist() == KEY.bits(Effect.RANGE, 25, 3).tolist()
