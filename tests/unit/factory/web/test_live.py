"""The pause between two readings of a farm page grows with the cost of a reading."""

from __future__ import annotations

from factory.web.live import pause_after


def test_the_poller_uses_at_most_two_percent_of_a_core() -> None:
    assert pause_after(0.001, 3.0) == 3.0
    for cost_s in (0.1, 1.0, 20.0):
        assert cost_s / (cost_s + pause_after(cost_s, 3.0)) <= 0.02
