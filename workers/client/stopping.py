"""Converts signals and closed pipes to threading events, for the entry points of long-running commands."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGUSR1)
"""Signals that request a stop. SIGUSR1 is one of them because Slurm sends it some time before the time limit of a job,
if the job requests this."""


@contextmanager
def stop_on_signals() -> Iterator[tuple[threading.Event, threading.Event]]:
    """Yields two events: SIGTERM, SIGUSR1 or Ctrl-C sets the first event, and Ctrl-C after that the second event.

    Further SIGTERM and SIGUSR1 change nothing, because batch systems send several to end one job.
    """
    stop, at_once = threading.Event(), threading.Event()

    def note(number: int, frame: FrameType | None) -> None:  # noqa: ARG001
        event = at_once if number == signal.SIGINT and stop.is_set() else stop
        # set in a thread, because this handler may have interrupted the holder of the lock that set() needs
        threading.Thread(target=event.set, daemon=True).start()

    former = {number: signal.signal(number, note) for number in _SIGNALS}
    try:
        yield stop, at_once
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)


@contextmanager
def signals_deferred() -> Iterator[None]:
    """Delays SIGTERM and Ctrl-C until the end of the block, so a process started there is known to the caller.

    Only for the main thread.
    """
    arrived: list[int] = []
    signals = (signal.SIGTERM, signal.SIGINT)
    former = {number: signal.signal(number, lambda got, _frame: arrived.append(got)) for number in signals}
    try:
        yield
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)
        for each in arrived:
            signal.raise_signal(each)


def stop_at_eof(descriptor: int, stop: threading.Event) -> None:
    """Sets `stop` when the process at the other end of the pipe `descriptor` closes it or dies."""

    def watch() -> None:
        while os.read(descriptor, 4096):
            pass
        stop.set()

    threading.Thread(target=watch, name="until-eof", daemon=True).start()
