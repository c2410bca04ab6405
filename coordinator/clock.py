"""Detects that the wall clock was set, by comparison with a monotonic clock. Does not set any clock."""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import UTC, datetime

_LEAST_S = 10.0
"""Smallest clock change that is reported, seconds. Smaller changes need no action, because the next heartbeat renews
every lease."""


def utc_now() -> datetime:
    return datetime.now(UTC)


def seconds_since_boot() -> float:
    """Returns the seconds since boot, including suspend; setting the wall clock does not change them."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class ClockWatch:
    """Detector of changes of the wall clock.

    Args:
        clock: wall clock.
        elapsed: monotonic clock, seconds.
    """

    def __init__(self, clock: Callable[[], datetime], elapsed: Callable[[], float]) -> None:
        self._clock, self._elapsed = clock, elapsed
        self._ahead = self._difference()

    def jump_s(self) -> float:
        """Returns the change of the wall clock since the start or the last `accept`, seconds; 0 if it was not set."""
        jump = self._difference() - self._ahead
        return jump if abs(jump) >= _LEAST_S else 0.0

    def accept(self) -> None:
        """Makes the current wall clock the reference for the next `jump_s`."""
        self._ahead = self._difference()

    def _difference(self) -> float:
        return self._clock().timestamp() - self._elapsed()
