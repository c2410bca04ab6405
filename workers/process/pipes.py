"""Pipes of a process that reads orders from stdin and reports to its original stdout. Does not parse the lines."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Callable
from typing import BinaryIO


def take_stdout() -> BinaryIO:
    """Returns the original stdout for reports, and redirects all other output, also of libraries, to stderr."""
    reports = os.dup(1)
    os.dup2(2, 1)
    return os.fdopen(reports, "wb", buffering=0)


def listen(descriptor: int, leave: Callable[[], None] = lambda: None) -> queue.Queue[bytes]:
    """Returns a queue of the received lines; this process exits as soon as the other side closes the pipe or dies.

    Args:
        descriptor: file descriptor of the pipe.
        leave: called before the exit, in another thread than the one that works.
    """
    lines: queue.Queue[bytes] = queue.Queue()

    def read() -> None:
        try:
            with os.fdopen(descriptor, "rb", closefd=False) as stream:
                for line in stream:
                    if line.endswith(b"\n"):
                        lines.put(line)
            leave()
        finally:
            os._exit(0)  # the result of the current work is no longer needed

    threading.Thread(target=read, name="orders", daemon=True).start()
    return lines
