"""Periodic tasks: a failing task neither stops the others nor floods the log."""

from __future__ import annotations

import threading

from coordinator.periodic_tasks import PeriodicTasks


def test_a_failing_task_is_retried_rarely_while_others_continue() -> None:
    done = {"broken": 0, "sound": 0}
    enough = threading.Event()

    def fail() -> None:
        done["broken"] += 1
        raise RuntimeError("the core is away")

    def work() -> None:
        done["sound"] += 1
        if done["broken"] >= 2 and done["sound"] >= 50:
            enough.set()

    with PeriodicTasks({"broken": (0.01, fail), "sound": (0.01, work)}) as running:
        assert enough.wait(60)
        assert running.is_alive
    assert done["broken"] < done["sound"] / 2
