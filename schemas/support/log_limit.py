"""Limits the rate of repeated log events, of a peer or of a loop that fails, and the repetitions of our own errors."""

from __future__ import annotations

import math
import threading
import time
import traceback
from collections.abc import Callable
from typing import Any

from schemas.errors import FactoryError

_MAX_KINDS = 1000
_MAX_ERROR_CHARS = 300
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 10.0, 600.0
_MOST_FAULTS = 5
"""Number of equal errors of this software, without a success between them, that end the loop."""


class LogLimit:
    """Rate limit of log lines: passes one line of each kind per pause and counts the others; safe for several threads.

    Args:
        pause_s: pause after the first line of a kind, seconds. It doubles with each further line, and returns to its
            first value when no line of the kind was written for one pause.
        longest_s: longest pause, seconds; `None` for a constant pause.
        clock: returns monotonic time in seconds; an argument, so a test can control time.
    """

    def __init__(
        self, pause_s: float = 1.0, longest_s: float | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._first_s, self._longest_s = pause_s, pause_s if longest_s is None else longest_s
        self._clock = clock
        self._guard = threading.Lock()
        self._kinds: dict[str, tuple[float, float, int]] = {}
        """By kind: earliest time of the next line, pause after that line, number of lines omitted since the last
        line."""

    def admit(self, kind: str = "") -> int | None:
        """Returns the number of omitted lines of a kind before this one, or `None` if this line is to be omitted."""
        now = self._clock()
        with self._guard:
            due, pause_s, omitted = self._kinds.get(kind, (-math.inf, self._first_s, 0))
            if now < due:
                self._kinds[kind] = due, pause_s, omitted + 1
                return None
            if now > due + pause_s:  # no line was requested for a whole pause after `due`
                pause_s = self._first_s
            if len(self._kinds) >= _MAX_KINDS:
                self._kinds.clear()
            self._kinds[kind] = now + pause_s, min(2 * pause_s, self._longest_s), 0
            return omitted

    def write(self, log: Callable[..., Any], event: str, peer: str = "", **fields: Any) -> None:
        """Logs an event of a peer with the number of omitted lines before it, unless the limit omits this line.

        Args:
            log: method of a structlog logger, e.g. `log.warning`.
            event: name of the event.
            peer: name of the peer, which has a separate limit; empty for a common limit.
            fields: fields of the log line.
        """
        omitted = self.admit(f"{event} {peer}")
        if omitted is not None:
            log(event, **fields, **({"omitted": omitted} if omitted else {}))


class Repeated:
    """Log of one kind of failure in a loop: logs the first failure, some of the next ones, and the recovery.

    Safe to use from several threads.

    Args:
        log: a structlog logger.
        event: name of the failure; its end is logged as `EVENT_recovered`.
        expected: exceptions with external causes, in addition to `FactoryError` and `OSError`; they are logged in one
            line. Other exceptions are logged once with their traceback.
        clock: returns monotonic time in seconds; an argument, so a test can control time.
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
        self._is_logged = False
        self._fault: BaseException | None = None
        self._faults = 0
        """Number of consecutive failures with the same error of this software, `_fault`."""
        self.failures = 0
        """Number of consecutive failures."""

    def fail(self, error: BaseException | str, **fields: Any) -> None:
        """Counts a failure and logs it, unless the limit omits it."""
        with self._guard:
            self.failures += 1
            count = self.failures
            self._count_fault(error)
            if count == 1:
                self._since = self._clock()
            if self._limit.admit() is None:
                return
            is_new, self._is_logged = not self._is_logged, True
        lines = str(error).splitlines() or [type(error).__name__]
        more = {} if count == 1 else {"failures": count}
        if is_new and isinstance(error, BaseException) and not isinstance(error, self._expected):
            self._log.error(self._event, error=lines[0], exc_info=error, **more, **fields)
        else:
            self._log.warning(self._event, error=lines[0], **more, **fields)

    def succeed(self) -> None:
        """Ends a series of failures; logs the recovery if one of them was logged."""
        with self._guard:
            count, self.failures = self.failures, 0
            self._fault, self._faults = None, 0
            was_logged, self._is_logged = self._is_logged, False
            lasted = self._clock() - self._since
        if was_logged:  # logged as a warning, so it is visible at the log level of the failure
            self._log.warning(f"{self._event}_recovered", failures=count, after_s=round(lasted))

    def require_no_fault(self) -> None:
        """Raises an error if another repetition cannot help, because the loop fails by an error of this software.

        Raises:
            RuntimeError: The last failures, without a success between them, were one unexpected exception, which is
                the cause.
        """
        with self._guard:
            fault, count = self._fault, self._faults
        if fault is not None and count >= _MOST_FAULTS:
            raise RuntimeError(f"{self._event} {count} times by the same error: {describe_error(fault)}") from fault

    def _count_fault(self, error: BaseException | str) -> None:
        if isinstance(error, str | MemoryError) or isinstance(error, self._expected):  # noqa: SIM101 - narrows the type
            self._fault, self._faults = None, 0
        elif self._fault is not None and _origin(error) == _origin(self._fault):
            self._faults += 1
        else:
            self._fault, self._faults = error, 1


def _origin(error: BaseException) -> tuple[type[BaseException], str, int]:
    """Returns the class of an error, and the file and line that raised it."""
    frames = traceback.extract_tb(error.__traceback__, limit=-1)
    return (type(error), frames[0].filename, frames[0].lineno or 0) if frames else (type(error), "", 0)


def describe_error(error: BaseException) -> str:
    """Returns an error as one short line: its class, its message, and the file and line that raised it."""
    frames = traceback.extract_tb(error.__traceback__, limit=-1)
    place = f" ({frames[0].filename.rpartition('/')[2]}:{frames[0].lineno})" if frames else ""
    message = " ".join(str(error)[:_MAX_ERROR_CHARS].split())
    return f"{type(error).__name__}: {message}{place}"
