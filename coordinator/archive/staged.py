"""A part file on its way into the archive: grows, is hashed as it grows, and leaves nothing behind when dropped."""

from __future__ import annotations

import hashlib
import os
from io import FileIO
from pathlib import Path
from types import TracebackType
from typing import Self

from coordinator.archive.disk import world_error

__all__ = ["Staged"]


class Staged:
    """A part file that grows and is hashed as it grows; it becomes an episode only by `Archive.publish`."""

    def __init__(self, path: Path, file: FileIO) -> None:
        self.path = path
        self.size = 0
        """Bytes written so far."""
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

    @property
    def sha256(self) -> str:
        """Digest of what was written so far."""
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

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.abandon()
