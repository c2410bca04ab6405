"""Shares the result of a costly function between all requests that arrive within a short time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")


class Recent(Generic[T]):
    """Result of a function, computed again when it is too old; thread-safe.

    Requests that arrive during a computation wait for its result instead of computing it, too.

    Args:
        compute: function whose result is shared.
        longest_s: maximum age of a result, seconds.
        clock: function that returns the time, seconds.
    """

    def __init__(self, compute: Callable[[], T], longest_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._compute, self._longest_s, self._clock = compute, longest_s, clock
        self._lock = threading.Lock()
        self._found: tuple[float, T] | None = None

    def get(self) -> T:
        """Returns the result, computed at most `longest_s` ago; raises what the function raises."""
        with self._lock:
            begin_s = self._clock()
            if self._found is None or begin_s - self._found[0] >= self._longest_s:
                self._found = begin_s, self._compute()
            return self._found[1]

    def forget(self) -> None:
        """Discards the result; called after a request has changed what the function reads."""
        with self._lock:
            self._found = None
