"""A thread that does chores at their intervals; one that fails is logged once and tried again, more and more seldom."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping

import structlog
from sqlalchemy.exc import SQLAlchemyError

from schemas.support.closing import Closing
from schemas.support.log_limit import Repeated

__all__ = ["Chore", "Housekeeper"]

Chore = tuple[float, Callable[[], None]]
"""Pause in seconds, and what to do."""

_SHARE = 20
"""A chore rests at least so many times as long as it took."""
_AFTER_FAILURE_S, _LONGEST_S = 2.0, 15.0
"""Pause after the first failure of a chore; it doubles up to the second. A longer interval of the chore stays."""

log = structlog.get_logger(__name__)


class Housekeeper(Closing):
    """Runs chores one after the other until closed; a context manager."""

    def __init__(self, chores: Mapping[str, Chore]) -> None:
        self._chores = chores
        self._failing = {name: Repeated(log.bind(chore=name), "chore_failed", (SQLAlchemyError,)) for name in chores}
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
            failing = self._failing[name]
            try:
                work()
            except Exception as error:  # noqa: BLE001 - the loop of chores: logged, and done again
                failing.fail(error)
                pause = max(pause, min(_AFTER_FAILURE_S * 2 ** min(failing.failures - 1, 10), _LONGEST_S))
            else:
                failing.succeed()
            ended = time.monotonic()
            due[name] = ended + max(pause, _SHARE * (ended - began) if pause >= 1 else 0.0)
