"""Runs tasks periodically in one thread. A failing task is logged once and retried with growing pauses."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping

import structlog
from sqlalchemy.exc import SQLAlchemyError

from schemas.support.closing import Closing
from schemas.support.log_limit import Repeated

PeriodicTask = tuple[float, Callable[[], None]]
"""Pause in seconds, and the function to call."""

_SHARE = 20
"""A task with a pause of at least 1 s pauses for at least this many times the duration of its last call."""
_AFTER_FAILURE_S, _LONGEST_S = 2.0, 15.0
"""Pause after the first failure of a task, and longest pause after failures, seconds. The pause doubles with each
failure in succession. A task with a longer interval keeps its interval."""

log = structlog.get_logger(__name__)


class PeriodicTasks(Closing):
    """Thread that runs tasks one after the other until closed; a context manager."""

    def __init__(self, tasks: Mapping[str, PeriodicTask]) -> None:
        self._tasks = tasks
        self._failing = {
            name: Repeated(log.bind(task=name), "periodic_task_failed", (SQLAlchemyError,)) for name in tasks
        }
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="periodic-tasks")
        self._thread.start()

    @property
    def is_alive(self) -> bool:
        return self._thread.is_alive()

    def require_no_fault(self) -> None:
        """Raises `RuntimeError` if a task fails by an error of this software; see `Repeated.require_no_fault`."""
        for failing in self._failing.values():
            failing.require_no_fault()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        due = {name: time.monotonic() + pause for name, (pause, _) in self._tasks.items()}
        while not self._stop.wait(max(0.0, min(due.values()) - time.monotonic())):
            name = min(due, key=due.__getitem__)
            pause, work = self._tasks[name]
            began = time.monotonic()
            failing = self._failing[name]
            try:
                work()
            except Exception as error:  # noqa: BLE001 - the loop of tasks: logged, and the task is repeated
                failing.fail(error)
                pause = max(pause, min(_AFTER_FAILURE_S * 2 ** min(failing.failures - 1, 10), _LONGEST_S))
            else:
                failing.succeed()
            ended = time.monotonic()
            due[name] = ended + max(pause, _SHARE * (ended - began) if pause >= 1 else 0.0)
