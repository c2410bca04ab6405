"""Limits how many lines a repeated event writes to the log: of a peer, or of a loop that fails again and again."""

from __future__ import annotations

import math
import threading
import time
import traceback
from collections.abc import Callable
from typing import Any

from schemas.errors import FactoryError

__all__ = ["LogLimit", "Repeated", "describe_error"]

_MAX_KINDS = 1000
_MAX_ERROR_CHARS = 300
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 10.0, 600.0


class LogLimit:
    """Passes one line of each kind per pause and counts those left out; safe to use from any thread.

    Args:
        pause_s: after the first line of a kind, seconds. It doubles with each further line and starts anew when the
            kind was quiet for a pause.
        longest_s: limit of the pause, seconds; `None` keeps the first one.
        clock: monotonic seconds; an argument, so that a test can let time pass.
    """

    def __init__(
        self, pause_s: float = 1.0, longest_s: float | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._first_s, self._longest_s = pause_s, pause_s if longest_s is None else longest_s
        self._clock = clock
        self._guard = threading.Lock()
        self._kinds: dict[str, tuple[float, float, int]] = {}
        """Kind -> when its next line may pass, the pause after that line, and how many were left out since the last."""

    def admit(self, kind: str = "") -> int | None:
        """Returns how many lines of a kind were left out before this one; `None` when this one is to be left out."""
        now = self._clock()
        with self._guard:
            due, pause_s, left_out = self._kinds.get(kind, (-math.inf, self._first_s, 0))
            if now < due:
                self._kinds[kind] = due, pause_s, left_out + 1
                return None
            if now > due + pause_s:
                pause_s = self._first_s  # the last ones are long past
            if len(self._kinds) >= _MAX_KINDS:
                self._kinds.clear()
            self._kinds[kind] = now + pause_s, min(2 * pause_s, self._longest_s), 0
            return left_out

    def write(self, log: Callable[..., Any], event: str, peer: str = "", **fields: Any) -> None:
        """Logs an event of a peer, with the number of lines left out before it, unless it is to be left out.

        Args:
            log: method of a structlog logger, e.g. `log.warning`.
            event: its name.
            peer: each has lines of its own; empty for all together.
            fields: of the line.
        """
        left_out = self.admit(f"{event} {peer}")
        if left_out is not None:
            log(event, **fields, **({"left_out": left_out} if left_out else {}))


class Repeated:
    """One kind of failure of a loop: logged once at first, seldom while it lasts, and once when it is over.

    Safe to use from any thread.

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
        self._limit = LogLimit(_FIRST_PAUSE_S, _LONGEST_PAUSE_S, clock)
        self._guard = threading.Lock()
        self._since = 0.0
        self._is_told = False
        self.failures = 0
        """In a row."""

    def fail(self, error: BaseException | str, **fields: Any) -> None:
        """Counts a failure and logs it, unless one was logged a short while ago."""
        with self._guard:
            self.failures += 1
            count = self.failures
            if count == 1:
                self._since = self._clock()
            if self._limit.admit() is None:
                return
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


def describe_error(error: BaseException) -> str:
    """Returns an error as one short line: its kind, its message, and the place that raised it."""
    frames = traceback.extract_tb(error.__traceback__, limit=-1)
    place = f" ({frames[0].filename.rpartition('/')[2]}:{frames[0].lineno})" if frames else ""
    message = " ".join(str(error)[:_MAX_ERROR_CHARS].split())
    return f"{type(error).__name__}: {message}{place}"
