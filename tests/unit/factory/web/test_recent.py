"""Shared results: when they are computed again, and which requests wait for a computation."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from factory.web.recent import Recent


class Counted:
    """Counts its calls; the clock is set by the test."""

    def __init__(self) -> None:
        self.calls, self.now_s = 0, 100.0

    def __call__(self) -> int:
        self.calls += 1
        return self.calls

    def recent(self) -> Recent[int]:
        return Recent(self, 3.0, clock=lambda: self.now_s)


def test_a_result_is_computed_again_when_it_is_too_old() -> None:
    counted = Counted()
    recent = counted.recent()
    assert (recent.get(), recent.get()) == (1, 1)
    counted.now_s += 2.9
    assert recent.get() == 1
    counted.now_s += 0.2
    assert recent.get() == 2


def test_a_forgotten_result_is_computed_again() -> None:
    recent = Counted().recent()
    assert recent.get() == 1
    recent.forget()
    assert recent.get() == 2


def test_requests_during_a_computation_wait_for_its_result() -> None:
    entered, leave = threading.Event(), threading.Event()
    counted = Counted()

    def compute() -> int:
        entered.set()
        assert leave.wait(60)
        return counted()

    recent = Recent(compute, 3.0)
    with ThreadPoolExecutor(4) as pool:
        first = pool.submit(recent.get)
        assert entered.wait(60)
        others = [pool.submit(recent.get) for _ in range(3)]
        leave.set()
        assert {each.result(60) for each in (first, *others)} == {1}


def test_a_failed_computation_is_tried_again_by_the_next_request() -> None:
    answers = iter([ValueError("damaged"), "sound"])

    def compute() -> str:
        answer = next(answers)
        if isinstance(answer, ValueError):
            raise answer
        return answer

    recent = Recent(compute, 3.0)
    with pytest.raises(ValueError, match="damaged"):
        recent.get()
    assert recent.get() == "sound"
