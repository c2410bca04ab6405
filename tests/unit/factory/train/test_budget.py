"""The size of the pictures and the number of epochs that fit into a time."""

from __future__ import annotations

import pytest

from factory.train.budget import choose


@pytest.mark.parametrize(
    ("hours", "chosen"),
    [
        (8.0, (160, 40)),  # at most 40 epochs
        (1.0, (160, 6)),
        (0.5, (128, 6)),
        (0.3, (64, 18)),
        (0.001, (64, 1)),  # at least one
    ],
)
def test_the_largest_size_with_six_epochs_is_chosen(hours: float, chosen: tuple[int, int]) -> None:
    rates = {160: 20.0, 128: 40.0, 64: 200.0}
    assert choose(hours, 10_000, 1_000, rates.__getitem__) == chosen


def test_validation_frames_count_in_part() -> None:
    assert choose(1.0, 10_000, 0, lambda _size: 20.0) == (160, 6)
    assert choose(1.0, 10_000, 10_000, lambda _size: 20.0) == (64, 4)
