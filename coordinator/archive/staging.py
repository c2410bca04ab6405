"""The local part of every archive: the lock of its one coordinator, and part files that grow beside it.

Empties the folder of part files when it opens, for whoever wrote them is gone. Knows no episode by content.
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
"""Pause before the lock is tried again, seconds."""


class Staging:
    """A directory held by this process alone, with room for part files.

    Args:
        root: the directory; it is made when it is not there.
        dataset: what is worked on, for the message to whoever comes second.

    Raises:
        WorldError: the directory cannot be written, or another coordinator works on it.
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
        """Opens a new part file for an episode; several may be open for one episode.

        Raises:
            WorldError: the directory cannot be written.
        """
        path = self.part(episode_id(index))
        try:
            return Staged(path, path.open("xb", buffering=0))
        except OSError as error:
            raise world_error("write", path.parent, error) from error

    def part(self, name: str) -> Path:
        """Returns the path of a part file that nobody else has."""
        return self.root / STAGING / f"{name}.{secrets.token_hex(8)}.part"

    def free_bytes(self) -> int:
        """Returns the bytes an ordinary user can still write to the file system."""
        with translated("ask the free space of", self.root):
            return shutil.disk_usage(self.root).free

    def close(self) -> None:
        """Lets another coordinator open the directory."""
        os.close(self._lock)


def is_held(root: Path) -> bool | None:
    """Returns whether a coordinator holds the directory now; `None` where this user cannot find out.

    Takes the lock for a moment, shared with others who ask; a coordinator that starts meanwhile waits for them.
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
    """Takes a lock without waiting; returns whether it was free."""
    try:
        fcntl.flock(descriptor, kind | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _take_alone(descriptor: int) -> bool:
    """Takes the lock of the one coordinator; returns whether no other coordinator holds it.

    A lock that can be shared is held by those who ask `is_held`, each for a moment.
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
