"""The learning rate and the running mean over a training."""

from __future__ import annotations

import pytest

from factory.train.options import ema_decay, learning_rate


def test_rate_rises_then_falls_to_a_small_share() -> None:
    rates = [learning_rate(step, 100, 1e-3, 10) for step in range(100)]
    assert max(rates) == pytest.approx(1e-3)
    assert rates.index(max(rates)) in {9, 10}
    assert rates[:10] == sorted(rates[:10])
    assert rates[10:] == sorted(rates[10:], reverse=True)
    assert 0 < rates[-1] < 0.03 * 1e-3


def test_rate_is_finite_beyond_the_end_and_without_warmup() -> None:
    assert learning_rate(500, 100, 1e-3, 0) == pytest.approx(2e-5)
    assert learning_rate(0, 1, 1e-3, 1) == 1e-3


def test_the_running_mean_discounts_its_noisy_start() -> None:
    decays = [ema_decay(step, 0.99) for step in range(2000)]
    assert decays[0] == pytest.approx(0.1)
    assert decays == sorted(decays)
    assert decays[-1] == 0.99
