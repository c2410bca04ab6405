"""Manages the local files of an archive: the lock of its coordinator and the folder of part files.

Opening deletes the part files of a previous process. The module does not read episodes.
"""

from __future__ import annotations

import fcntl
import os
import secrets
import shutil
import time
from pathlib import Path

from coordinator.archive.staged import Staged
from schemas.dataset_files import STAGING
from schemas.errors import WorldError
from schemas.job import episode_id
from schemas.storage.disk import translated, world_error

__all__ = ["Staging", "is_held"]

_LOCK = ".lock"
_ASKED_S = 0.001
"""Pause between two attempts to take the lock, seconds."""


class Staging:
    """Exclusively locked directory with a folder for part files.

    Args:
        root: directory; created if it does not exist.
        dataset: name of the dataset for the error message of a second process.

    Raises:
        WorldError: the directory cannot be written, or another coordinator holds it.
    """

    def __init__(self, root: Path, dataset: str) -> None:
        self.root = root
        with translated("open", root):
            root.mkdir(parents=True, exist_ok=True)
            self._lock = _lock(root / _LOCK, dataset)
        try:
            with translated("open", root):
                (root / STAGING).mkdir(exist_ok=True)
                _clear(root / STAGING)
        except WorldError:
            self.close()
            raise

    def stage(self, index: int) -> Staged:
        """Opens a new part file for an episode. An episode may have several open part files.

        Raises:
            WorldError: the directory cannot be written.
        """
        path = self.part(episode_id(index))
        try:
            return Staged(path, path.open("xb", buffering=0))
        except OSError as error:
            raise world_error("write", path.parent, error) from error

    def part(self, name: str) -> Path:
        """Returns a unique path for a part file."""
        return self.root / STAGING / f"{name}.{secrets.token_hex(8)}.part"

    def free_bytes(self) -> int:
        """Returns the free space of the file system for an unprivileged user, bytes."""
        with translated("ask the free space of", self.root):
            return shutil.disk_usage(self.root).free

    def close(self) -> None:
        """Releases the directory, so that another coordinator can open it."""
        os.close(self._lock)


def is_held(root: Path) -> bool | None:
    """Returns whether a coordinator holds the directory; `None` if this user may not read the lock file.

    The function takes a shared lock briefly; a coordinator that starts meanwhile waits until the lock is released.
    """
    try:
        descriptor = os.open(root / _LOCK, os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        return False
    except OSError:
        return None
    try:
        return not _take(descriptor, fcntl.LOCK_SH)
    except OSError:
        return None
    finally:
        os.close(descriptor)


def _take(descriptor: int, kind: int) -> bool:
    """Tries to take a lock without blocking; returns whether it succeeded."""
    try:
        fcntl.flock(descriptor, kind | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _take_alone(descriptor: int) -> bool:
    """Takes the exclusive lock of a coordinator; returns `False` if another coordinator holds it.

    If a shared lock is available, only callers of `is_held` hold the lock, each briefly.
    """
    while not _take(descriptor, fcntl.LOCK_EX):
        if not _take(descriptor, fcntl.LOCK_SH):
            return False
        fcntl.flock(descriptor, fcntl.LOCK_UN)
        time.sleep(_ASKED_S)
    return True


def _lock(path: Path, dataset: str) -> int:
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    if not _take_alone(descriptor):
        owner = os.pread(descriptor, 32, 0).decode("ascii", "replace").strip() or "unknown"
        os.close(descriptor)
        message = f"another coordinator works on {dataset} (pid {owner}): stop it first, or choose another --out"
        raise WorldError(message)
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, f"{os.getpid()}\n".encode(), 0)
    return descriptor


def _clear(directory: Path) -> None:
    for path in directory.iterdir():
        if path.is_file() or path.is_symlink():
            path.unlink()
