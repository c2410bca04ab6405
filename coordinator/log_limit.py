"""Keeps a peer from filling the log: at most one line of a kind in a while, and an error as one line. Writes no log."""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable

__all__ = ["LogLimit", "describe_error"]

_MAX_KINDS = 1000
_MAX_ERROR_CHARS = 300


class LogLimit:
    """Passes one line of each kind per pause and counts those left out; safe to use from any thread.

    Args:
        pause_s: between two lines of a kind, seconds.
        clock: monotonic seconds.
    """

    def __init__(self, pause_s: float = 1.0, clock: Callable[[], float] = time.monotonic) -> None:
        self._pause_s = pause_s
        self._clock = clock
        self._guard = threading.Lock()
        self._kinds: dict[str, tuple[float, int]] = {}
        """Kind -> when its last line passed, and how many were left out since."""

    def admit(self, kind: str) -> int | None:
        """Returns how many lines of a kind were left out before this one; `None` when this one is to be left out."""
        now = self._clock()
        with self._guard:
            passed, left_out = self._kinds.get(kind, (float("-inf"), 0))
            if now - passed < self._pause_s:
                self._kinds[kind] = passed, left_out + 1
                return None
            if len(self._kinds) >= _MAX_KINDS:
                self._kinds.clear()
            self._kinds[kind] = now, 0
            return left_out


def describe_error(error: BaseException) -> str:
    """Returns an error as one short line: its kind, its message, and the place that raised it."""
    frames = traceback.extract_tb(error.__traceback__, limit=-1)
    place = f" ({frames[0].filename.rpartition('/')[2]}:{frames[0].lineno})" if frames else ""
    message = " ".join(str(error)[:_MAX_ERROR_CHARS].split())
    return f"{type(error).__name__}: {message}{place}"
