"""Growing pauses between tries that go wrong. Computes them; never sleeps."""

from __future__ import annotations

__all__ = ["Backoff"]


class Backoff:
    """Doubles from `first_s` to `longest_s` until told that something went well."""

    def __init__(self, first_s: float, longest_s: float) -> None:
        self._first_s, self._longest_s = first_s, longest_s
        self.failures = 0
        """Failures since the last success."""

    def fail(self) -> float:
        """Counts a failure and returns how long to pause, in seconds."""
        self.failures += 1
        return min(self._longest_s, self._first_s * 2.0 ** min(self.failures - 1, 32))

    def succeed(self) -> None:
        """Starts again from the shortest pause."""
        self.failures = 0
