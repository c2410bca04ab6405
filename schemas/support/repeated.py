"""Logs a failure that a loop meets again and again: once at first, seldom while it lasts, and once when it is over."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any

from schemas.errors import FactoryError

__all__ = ["Repeated"]

_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 10.0, 600.0


class Repeated:
    """One kind of failure; safe to use from any thread.

    Args:
        log: a structlog logger.
        event: name of the failure; its end is logged as `EVENT_recovered`.
        expected: exceptions that the surroundings cause besides ours and the system's: one line. Others bring their
            traceback, once.
        clock: seconds from any start; an argument, so that a test can let time pass.
    """

    def __init__(
        self,
        log: Any,
        event: str,
        expected: tuple[type[BaseException], ...] = (),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._log, self._event, self._clock = log, event, clock
        self._expected: tuple[type[BaseException], ...] = (FactoryError, OSError, *expected)
        self._guard = threading.Lock()
        self._since, self._due = 0.0, -math.inf
        self._pause = _FIRST_PAUSE_S
        self._is_told = False
        self.failures = 0
        """In a row."""

    def fail(self, error: BaseException | str, **fields: Any) -> None:
        """Counts a failure and logs it, unless one was logged a short while ago."""
        with self._guard:
            self.failures += 1
            count, now = self.failures, self._clock()
            if count == 1:
                self._since = now
            if now < self._due:
                return
            if now > self._due + self._pause:
                self._pause = _FIRST_PAUSE_S  # the last ones are long past
            self._due, self._pause = now + self._pause, min(2 * self._pause, _LONGEST_PAUSE_S)
            is_new, self._is_told = not self._is_told, True
        lines = str(error).splitlines() or [type(error).__name__]
        more = {} if count == 1 else {"failures": count}
        if is_new and isinstance(error, BaseException) and not isinstance(error, self._expected):
            self._log.error(self._event, error=lines[0], exc_info=error, **more, **fields)
        else:
            self._log.warning(self._event, error=lines[0], **more, **fields)

    def succeed(self) -> None:
        """Ends a row of failures; the end is logged if one of them was."""
        with self._guard:
            count, self.failures = self.failures, 0
            was_told, self._is_told = self._is_told, False
            lasted = self._clock() - self._since
        if was_told:  # a warning, because it is to be seen wherever the failure was
            self._log.warning(f"{self._event}_recovered", failures=count, after_s=round(lasted))
