"""A part file on its way into the archive: grows, or is taken whole; is hashed, and leaves nothing behind."""

from __future__ import annotations

import hashlib
import os
from io import FileIO
from pathlib import Path

from schemas.storage.disk import world_error
from schemas.support.closing import Closing

__all__ = ["Staged"]


class Staged(Closing):
    """A part file that grows and is hashed as it grows; it becomes an episode only by `Archive.publish`."""

    def __init__(self, path: Path, file: FileIO) -> None:
        self.path = path
        self.size = 0
        """Bytes that are there so far."""
        self._file = file
        self._hash = hashlib.sha256()

    def write(self, data: bytes) -> None:
        """Appends bytes.

        Raises:
            WorldError: the disk is full or gone; the part file has been removed.
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
        """Becomes another name of a file on this disk, and hashes it; whoever wrote it must not write to it again.

        Args:
            source: the file.

        Raises:
            OSError: there is none, it lies on another disk, or the disk knows no second names; nothing has changed.
            WorldError: it cannot be read; the part file has been removed.
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
        """Digest of what is there so far."""
        return self._hash.hexdigest()

    def flush(self) -> None:
        """Makes the bytes durable.

        Raises:
            WorldError: the disk is full or gone; the part file has been removed.
        """
        try:
            os.fsync(self._file.fileno())
        except OSError as error:
            self.abandon()
            raise world_error("write", self.path.parent, error) from error

    def abandon(self) -> None:
        """Closes and deletes the part file; does nothing once it is published or abandoned."""
        if not self._file.closed:
            self._file.close()
            self.path.unlink(missing_ok=True)

    def close(self) -> None:
        """Abandons the part file unless it is published."""
        self.abandon()
