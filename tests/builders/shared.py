"""Gives the processes of a test session a common folder with data that is built once."""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path


def session_folder(own: Path) -> Path:
    """Returns the folder of all processes of a session.

    Args:
        own: pytest's base folder of this process; for a pytest-xdist worker it is inside the folder of the session.
    """
    folder = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "shared"
    folder.mkdir(exist_ok=True)
    return folder


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Holds the lock of a file; if a process is killed, the kernel releases its lock."""
    with path.open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def build_once(folder: Path, build: Callable[[Path], object]) -> Path:
    """Builds a folder in the first process that calls this; the others wait for it. Tests must only read the folder.

    Args:
        folder: target folder; leftovers of a failed build are removed.
        build: builds into the given folder, which does not exist yet.

    Returns:
        `folder`.
    """
    done = folder.with_name(f"{folder.name}.done")
    with locked(folder.with_name(f"{folder.name}.lock")):
        if not done.exists():
            shutil.rmtree(folder, ignore_errors=True)
            build(folder)
            done.touch()
    return folder
