"""Writes and hashes part files of the archive. Does not publish them."""

from __future__ import annotations

import hashlib
import os
from io import FileIO
from pathlib import Path

from schemas.storage.disk import world_error
from schemas.support.closing import Closing

__all__ = ["Staged"]


class Staged(Closing):
    """Part file that is hashed while it is written; `Archive.publish` turns it into an episode."""

    def __init__(self, path: Path, file: FileIO) -> None:
        self.path = path
        self.size = 0
        """Bytes written so far."""
        self._file = file
        self._hash = hashlib.sha256()

    def write(self, data: bytes) -> None:
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

    def take(self, source: Path) -> None:
        """Replaces the part file with a hard link to an existing file and hashes it.

        No process may write to the file afterwards.

        Args:
            source: file on the same disk.

        Raises:
            OSError: the file does not exist, is on another disk, or the file system has no hard links; nothing has
                changed.
            WorldError: the file cannot be read; the part file has been removed.
        """
        link = self.path.with_suffix(".link")
        os.link(source, link)
        try:
            link.replace(self.path)
            taken = self.path.open("rb", buffering=0)
            self._file.close()
            self._file = taken
            self._hash = hashlib.file_digest(self._file, "sha256")
            self.size = os.fstat(self._file.fileno()).st_size
        except OSError as error:
            link.unlink(missing_ok=True)
            self.abandon()
            raise world_error("read", source.parent, error) from error

    @property
    def sha256(self) -> str:
        """SHA-256 of the bytes written so far, hexadecimal."""
        return self._hash.hexdigest()

    def flush(self) -> None:
        """Flushes the bytes durably to the disk.

        Raises:
            WorldError: the disk is full or unavailable; the part file has been removed.
        """
        try:
            os.fsync(self._file.fileno())
        except OSError as error:
            self.abandon()
            raise world_error("write", self.path.parent, error) from error

    def abandon(self) -> None:
        """Closes and deletes the part file. Does nothing if it is published or abandoned already."""
        if not self._file.closed:
            self._file.close()
            self.path.unlink(missing_ok=True)

    def close(self) -> None:
        """Deletes the part file unless it is published."""
        self.abandon()
