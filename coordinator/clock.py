"""Notices that the wall clock of this machine was set, by comparing it with the time that has passed. Sets nothing."""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import UTC, datetime

__all__ = ["ClockWatch", "seconds_since_boot", "utc_now"]

_LEAST_S = 10.0
"""Smaller steps are left alone: they cost no lease that a beat does not renew."""


def utc_now() -> datetime:
    """Returns the time of this machine, in UTC."""
    return datetime.now(UTC)


def seconds_since_boot() -> float:
    """Returns seconds that pass whatever the clock is set to, also while the machine sleeps."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class ClockWatch:
    """Watches one clock.

    Args:
        clock: the wall clock.
        elapsed: seconds that pass evenly.
    """

    def __init__(self, clock: Callable[[], datetime], elapsed: Callable[[], float]) -> None:
        self._clock, self._elapsed = clock, elapsed
        self._ahead = self._difference()

    def jump_s(self) -> float:
        """Returns by how much the clock was set since the start or the last `accept`; 0 when it was not."""
        jump = self._difference() - self._ahead
        return jump if abs(jump) >= _LEAST_S else 0.0

    def accept(self) -> None:
        """Takes the clock as it is from now on."""
        self._ahead = self._difference()

    def _difference(self) -> float:
        return self._clock().timestamp() - self._elapsed()
