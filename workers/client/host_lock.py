"""File lock among the threads and processes of a host; the kernel releases it when its holder ends or crashes."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def exclusive_lock(path: Path, wait: Callable[[], None]) -> Iterator[None]:
    """Holds the lock during the block.

    Args:
        path: path of the lock file; it is created if missing, and not deleted.
        wait: called repeatedly while another thread or process holds the lock; it sleeps, and may raise to give up.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        while True:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                wait()
        yield
    finally:
        os.close(descriptor)
