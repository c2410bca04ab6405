"""Signals of the entry points of long-running commands."""

from __future__ import annotations

import signal

import pytest

from workers.client.stopping import signals_deferred


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_deferred_signal_is_handled_after_the_block(number: signal.Signals) -> None:
    former = signal.signal(number, signal.default_int_handler)
    done = []

    def interrupted() -> None:
        with signals_deferred():
            signal.raise_signal(number)
            done.append("the block")

    try:
        with pytest.raises(KeyboardInterrupt):
            interrupted()
        assert signal.getsignal(number) is signal.default_int_handler
    finally:
        signal.signal(number, former)
    assert done == ["the block"]
