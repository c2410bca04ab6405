"""File lock among the threads and processes of a host; the kernel releases it when its holder ends or crashes."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from schemas.errors import WorldError
from schemas.storage.disk import translated

FOLDER_LOCK = ".lock"
"""Lock file in an output folder; it is not deleted, because another process could have opened it."""


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


@contextmanager
def sole_use(folder: Path, what: str) -> Iterator[None]:
    """Holds the lock of an output folder during the block; a second process is refused at once.

    Args:
        folder: existing folder.
        what: what writes to the folder, for the message, such as "evaluation".

    Raises:
        WorldError: another process holds the lock, or the file system has no locks or cannot be written.
    """

    def refuse() -> None:
        raise WorldError(f"{folder} is in use by another {what}: wait for its end, or choose another -o")

    with ExitStack() as held:
        with translated("lock", folder):
            held.enter_context(exclusive_lock(folder / FOLDER_LOCK, refuse))
        yield
