"""The pipes of a process that takes orders on stdin and reports on what was its stdout. Knows not what lines say."""

from __future__ import annotations

import os
import queue
import threading
from typing import BinaryIO

__all__ = ["listen", "take_stdout"]


def take_stdout() -> BinaryIO:
    """Keeps stdout for reports and lets everything else that is printed, by libraries too, go to stderr."""
    mine = os.dup(1)
    os.dup2(2, 1)
    return os.fdopen(mine, "wb", buffering=0)


def listen(descriptor: int) -> queue.Queue[bytes]:
    """Returns a queue of the lines that arrive; when the other side closes or dies, so does this process, at once."""
    lines: queue.Queue[bytes] = queue.Queue()

    def read() -> None:
        try:
            with os.fdopen(descriptor, "rb", closefd=False) as stream:
                for line in stream:
                    if line.endswith(b"\n"):
                        lines.put(line)
        finally:
            os._exit(0)  # nobody is left to use what is being done

    threading.Thread(target=read, name="orders", daemon=True).start()
    return lines
