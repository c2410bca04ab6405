"""Updates the shared status during an episode: the current activity, its time limit, and the progress of the robot.

Starts no process and calls no policy.
"""

from __future__ import annotations

import math
import time

from factory.eval.driving.simulator import Simulator
from factory.eval.process.shared_status import Activity, DriverStatus, SharedStatus
from workers.experts.observation import Observation

__all__ = ["StatusWriter"]


class StatusWriter:
    """Observer of policy calls that writes every change to the shared status."""

    def __init__(self, shared: SharedStatus) -> None:
        self._shared = shared
        self._state = DriverStatus()
        self._last: tuple[float, float] | None = None
        self._calls = 0
        self.is_warm = False
        """Whether the policy has given an answer; the first one may take long."""
        self.is_privileged = False
        """Whether the policy renders and plans itself; its time counts as the simulation's."""

    def note(self, busy: Activity) -> None:
        """Writes the current activity."""
        self._state = self._state._replace(busy=busy, since_s=time.monotonic())
        self._shared.write(self._state)

    def begin(self, busy: Activity) -> None:
        """Writes the current activity and resets the distances for a new episode."""
        self._state, self._last, self._calls = DriverStatus(), None, 0
        self.note(busy)

    def before_call(self, simulator: Simulator, view: Observation) -> None:
        """Writes the progress before a policy call."""
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

    def after_call(self) -> None:
        """Writes the activity after a policy call."""
        self.is_warm = self.is_warm or self._calls > 1  # the first one is the reset
        self.note(Activity.SIMULATING)
