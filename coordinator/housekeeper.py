"""A thread that does chores at their intervals; a chore that fails is logged and done again next time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping

import structlog

from schemas.closing import Closing

__all__ = ["Chore", "Housekeeper"]

Chore = tuple[float, Callable[[], None]]
"""Pause in seconds, and what to do."""

_SHARE = 20
"""A chore rests at least so many times as long as it took."""
_AFTER_FAILURE_S = 2.0
"""Least pause after a chore that failed: one that is done four times a second would fill the log."""

log = structlog.get_logger(__name__)


class Housekeeper(Closing):
    """Runs chores one after the other until closed; a context manager."""

    def __init__(self, chores: Mapping[str, Chore]) -> None:
        self._chores = chores
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="housekeeper")
        self._thread.start()

    @property
    def is_alive(self) -> bool:
        """Whether its thread runs."""
        return self._thread.is_alive()

    def close(self) -> None:
        """Ends after the chore in hand."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        due = {name: time.monotonic() + pause for name, (pause, _) in self._chores.items()}
        while not self._stop.wait(max(0.0, min(due.values()) - time.monotonic())):
            name = min(due, key=due.__getitem__)
            pause, work = self._chores[name]
            began = time.monotonic()
            try:
                work()
            except Exception:
                log.exception("chore_failed", chore=name)
                pause = max(pause, _AFTER_FAILURE_S)
            ended = time.monotonic()
            due[name] = ended + max(pause, _SHARE * (ended - began) if pause >= 1 else 0.0)
