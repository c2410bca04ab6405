"""Termination conditions of an episode: success, collision and timeout, computed from poses and commands.

Does not simulate or render.
"""

from __future__ import annotations

import math
from collections import deque

from schemas.config import TaskConfig
from schemas.terms import EndReason


class Termination:
    """Evaluates the frames of one episode in order (paper Sec. II-A; docs/design/task.md#ends-of-an-episode).

    A frame is evaluated before its action is executed. Success requires `hold_steps` consecutive frames inside the
    radius with a measured speed below the limit, so it can be verified from the recorded poses alone.
    """

    def __init__(self, task: TaskConfig, hold_steps: int | None = None) -> None:
        self._task = task
        self._hold_steps = task.hold_steps if hold_steps is None else hold_steps
        self._held = 0
        self._frames = 0
        self._forward = 0
        self._track: deque[tuple[float, float]] = deque(maxlen=task.stall_steps + 1)

    def evaluate(
        self, x_m: float, y_m: float, distance_m: float, is_blocked: bool, commanded_mps: float
    ) -> EndReason | None:
        """Evaluates the next frame.

        Args:
            x_m: x of base_link in the world frame, metres.
            y_m: y of base_link in the world frame, metres.
            distance_m: planar distance to the target by the success measure, metres.
            is_blocked: whether the robot has a contact or an obstacle is near.
            commanded_mps: speed of the action of this frame, m/s.

        Returns:
            Reason if the episode ends with this frame, else `None`.
        """
        is_stalled = self.would_stall(x_m, y_m, commanded_mps)
        self._frames += 1
        self._track.append((x_m, y_m))
        self._held = self._held + 1 if self._is_stationary() and distance_m <= self._task.success_radius_m else 0
        self._forward = self._forward + 1 if commanded_mps > 0 else 0
        if self._held >= self._hold_steps:
            return EndReason.SUCCESS
        if is_blocked and is_stalled:
            return EndReason.COLLISION
        return EndReason.TIMEOUT if self._frames >= self._task.max_steps else None

    def would_stall(self, x_m: float, y_m: float, commanded_mps: float) -> bool:
        """Returns whether a robot that is commanded forward makes no progress in the steps up to the next frame.

        If it returns `False`, `evaluate` ignores `is_blocked`.

        Args:
            x_m: x of base_link in the next frame, metres.
            y_m: y of base_link in the next frame, metres.
            commanded_mps: speed of its action, m/s.
        """
        steps = self._task.stall_steps
        if commanded_mps <= 0 or self._forward + 1 < steps or len(self._track) < steps:
            return False
        return math.dist((x_m, y_m), self._track[-steps]) < self._task.stall_progress_m

    def _is_stationary(self) -> bool:
        if len(self._track) < 2:
            return False
        moved_m = math.dist(self._track[-1], self._track[-2])
        return moved_m * self._task.control_hz < self._task.stationary_speed_mps
