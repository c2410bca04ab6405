"""Computes the pauses of an exponential backoff. Does not sleep."""

from __future__ import annotations

__all__ = ["Backoff"]


class Backoff:
    """Exponential backoff from `first_s` to `longest_s` seconds that doubles with each failure."""

    def __init__(self, first_s: float, longest_s: float) -> None:
        self._first_s, self._longest_s = first_s, longest_s
        self.failures = 0
        """Number of failures since the last success."""

    def fail(self) -> float:
        """Counts a failure and returns the time to pause, seconds."""
        self.failures += 1
        return min(self._longest_s, self._first_s * 2.0 ** min(self.failures - 1, 32))

    def succeed(self) -> None:
        """Resets the backoff to the shortest pause."""
        self.failures = 0
