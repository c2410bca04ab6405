"""Timeouts of policy calls: the load timeout for a reset and a first answer, otherwise the action timeout."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from factory.eval.process.shared_status import Activity, SharedStatus, StatusWriter
from workers.geometry.pose import Pose

DRIVE: Any = SimpleNamespace(steps=3, contact_steps=1)


def at(x: float, distance_m: float) -> Any:
    return SimpleNamespace(pose=Pose.planar(x, 0.0, 0.0), distance_m=distance_m)


@pytest.fixture
def status() -> Iterator[SharedStatus]:
    opened = SharedStatus.fresh()
    yield opened
    opened.close()


def busy_when_asked(status: SharedStatus, watch: StatusWriter, calls: int) -> list[Activity]:
    """Returns the activity during each call of an episode; the first call is the reset."""
    watch.begin(Activity.SIMULATING)
    found = []
    for _ in range(calls):
        watch.before_call(DRIVE, at(0.0, 2.0))
        found.append(status.read().busy)
        watch.after_call()
    return found


def test_only_answers_after_the_first_one_have_the_strict_timeout(status: SharedStatus) -> None:
    watch = StatusWriter(status)
    assert busy_when_asked(status, watch, 4) == [Activity.MAKING, Activity.MAKING, Activity.ASKING, Activity.ASKING]
    assert busy_when_asked(status, watch, 3) == [Activity.MAKING, Activity.ASKING, Activity.ASKING]
    watch.is_warm = False  # the next calls use a new connection
    assert busy_when_asked(status, watch, 3) == [Activity.MAKING, Activity.MAKING, Activity.ASKING]


def test_the_time_of_an_expert_counts_as_simulation_time(status: SharedStatus) -> None:
    watch = StatusWriter(status)
    watch.is_privileged = True
    assert busy_when_asked(status, watch, 4) == [Activity.SIMULATING] * 4


def test_the_shared_status_has_the_progress_of_the_robot(status: SharedStatus) -> None:
    watch = StatusWriter(status)
    watch.begin(Activity.SIMULATING)
    for x, distance_m in ((0.0, 2.0), (0.5, 1.5), (0.2, 1.8)):
        watch.before_call(DRIVE, at(x, distance_m))
    state = status.read()
    assert (state.steps, state.contact_steps) == (3, 1)
    assert (state.start_m, state.least_m, state.now_m) == (2.0, 1.5, 1.8)
    assert state.driven_m == pytest.approx(0.8)
