"""Manages the local files of an archive: the lock of its coordinator, and part files, which are hashed when written.

Opening deletes the part files of a previous process. The module does not read or publish episodes.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import secrets
import shutil
import time
from io import FileIO
from pathlib import Path

from schemas.errors import WorldError
from schemas.job import episode_id
from schemas.storage.dataset_files import STAGING
from schemas.storage.disk import translated, world_error
from schemas.storage.shards import MAX_PACKED_BYTES
from schemas.support.closing import Closing

_LOCK = ".lock"
_ASKED_S = 0.001
"""Pause between two attempts to take the lock, seconds."""


class PartFile(Closing):
    """Part file that is hashed while it is written; `Archive.publish` turns it into an episode."""

    def __init__(self, path: Path, file: FileIO) -> None:
        self.path = path
        self.size = 0
        """Bytes written so far."""
        self.is_linked = False
        """Whether the part file is a hard link to a file that another process has written, see `link`."""
        self._file = file
        self._hash = hashlib.sha256()

    def write(self, data: bytes | memoryview) -> None:
        """Appends bytes.

        Raises:
            WorldError: the disk is full or unavailable; the part file has been removed.
        """
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            self.abandon()
            raise world_error("write", self.path.parent, error) from error
        self._hash.update(data)
        self.size += len(data)

    def link(self, source: Path) -> None:
        """Replaces the part file with a hard link to an existing file.

        No process may write to the file afterwards.

        Args:
            source: file on the same disk.

        Raises:
            OSError: the file does not exist, is on another disk, or the file system has no hard links; nothing has
                changed.
            WorldError: the file cannot be read; the part file has been removed.
        """
        temporary = self.path.with_suffix(".link")
        os.link(source, temporary)
        try:
            temporary.replace(self.path)
            linked = self.path.open("rb", buffering=0)
            self._file.close()
            self._file = linked
            self.size = os.fstat(self._file.fileno()).st_size
            self.is_linked = True
        except OSError as error:
            temporary.unlink(missing_ok=True)
            self.abandon()
            raise world_error("read", source.parent, error) from error

    @property
    def sha256(self) -> str:
        """SHA-256 of the bytes written so far, hexadecimal; of a linked file, it is computed at every access."""
        if self.is_linked:
            self._file.seek(0)
            return hashlib.file_digest(self._file, "sha256").hexdigest()
        return self._hash.hexdigest()

    def flush(self) -> None:
        """Flushes the bytes durably to the disk, and frees the page cache of a large file that was transferred.

        The next file can then use this memory. Small files keep their cache, because packing reads them.

        Raises:
            WorldError: the disk is full or unavailable; the part file has been removed.
        """
        try:
            os.fsync(self._file.fileno())
        except OSError as error:
            self.abandon()
            raise world_error("write", self.path.parent, error) from error
        # a copy into page cache that was not used recently is several times slower
        if self.size > MAX_PACKED_BYTES and not self.is_linked:
            with contextlib.suppress(OSError):  # a file system may refuse the advice; the bytes are on the disk
                os.posix_fadvise(self._file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)

    def abandon(self) -> None:
        """Closes and deletes the part file. Does nothing if it is published or abandoned already."""
        if not self._file.closed:
            self._file.close()
            self.path.unlink(missing_ok=True)

    def close(self) -> None:
        """Deletes the part file unless it is published."""
        self.abandon()


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

    def stage(self, index: int) -> PartFile:
        """Opens a new part file for an episode. An episode may have several open part files.

        Raises:
            WorldError: the directory cannot be written.
        """
        path = self.part(episode_id(index))
        try:
            return PartFile(path, path.open("xb", buffering=0))
        except OSError as error:
            raise world_error("write", path.parent, error) from error

    def part(self, name: str) -> Path:
        """Returns a unique path for a part file."""
        return self.root / STAGING / f"{name}.{secrets.token_hex(8)}.part"

    def free_bytes(self) -> int:
        """Returns the free space of the file system for an unprivileged user, bytes."""
        with translated("read the free space of", self.root):
            return shutil.disk_usage(self.root).free

    def close(self) -> None:
        """Releases the directory, so another coordinator can open it."""
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


def _take_exclusive(descriptor: int) -> bool:
    """Takes the exclusive lock of a coordinator; returns `False` if another coordinator holds it.

    If a shared lock can be taken, no coordinator holds the directory; the exclusive lock failed because a caller of
    `is_held` held a shared lock for a moment. The function then tries again.
    """
    while not _take(descriptor, fcntl.LOCK_EX):
        if not _take(descriptor, fcntl.LOCK_SH):
            return False
        fcntl.flock(descriptor, fcntl.LOCK_UN)
        time.sleep(_ASKED_S)
    return True


def _lock(path: Path, dataset: str) -> int:
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    if not _take_exclusive(descriptor):
        owner = os.pread(descriptor, 32, 0).decode("ascii", "replace").strip() or "unknown"
        os.close(descriptor)
        message = f"another coordinator works on {dataset} (pid {owner}): stop it first, or choose another --out"
        raise WorldError(message)
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, f"{os.getpid()}\n".encode(), 0)
    return descriptor


def _clear(directory: Path) -> None:
    for path in directory.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)  # the path is a folder into which a layout was unpacked
        else:
            path.unlink()
