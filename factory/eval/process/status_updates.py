"""Notes on the sheet what an episode is at: who is waited for, under which limit, and how far the robot has come.

Knows no process and no policy but for what it is told of it.
"""

from __future__ import annotations

import math
import time

from factory.eval.driving.simulator import Simulator
from factory.eval.process.shared_status import Activity, DriverStatus, SharedStatus
from workers.experts.observation import Observation

__all__ = ["SheetWatch"]


class SheetWatch:
    """Writes every turn down; a `Watch` of the rollout."""

    def __init__(self, sheet: SharedStatus) -> None:
        self._sheet = sheet
        self._state = DriverStatus()
        self._last: tuple[float, float] | None = None
        self._calls = 0
        self.is_warm = False
        """Whether the policy has given an answer; the first one may take long."""
        self.is_privileged = False
        """Whether the policy renders and plans itself; its time counts as the simulation's."""

    def note(self, busy: Activity) -> None:
        """Writes down what is being done from now on."""
        self._state = self._state._replace(busy=busy, since_s=time.monotonic())
        self._sheet.write(self._state)

    def begin(self, busy: Activity) -> None:
        """The same, with the distances of a new episode."""
        self._state, self._last, self._calls = DriverStatus(), None, 0
        self.note(busy)

    def asks(self, simulator: Simulator, view: Observation) -> None:
        """The policy is about to be asked."""
        self._calls += 1
        here, state = (view.pose.x, view.pose.y), self._state
        moved = 0.0 if self._last is None else math.dist(self._last, here)
        is_first, self._last = self._last is None, here
        self._state = state._replace(
            steps=simulator.steps,
            start_m=view.distance_m if is_first else state.start_m,
            now_m=view.distance_m,
            least_m=view.distance_m if is_first else min(state.least_m, view.distance_m),
            driven_m=state.driven_m + moved,
            contact_steps=simulator.contact_steps,
        )
        if not self.is_privileged:
            is_reset = self._calls == 1
            self.note(Activity.ASKING if self.is_warm and not is_reset else Activity.MAKING)

    def has_answer(self) -> None:
        """The policy has answered."""
        self.is_warm = self.is_warm or self._calls > 1  # the first one is the reset
        self.note(Activity.SIMULATING)
