"""Path of an episode within a shard, with the part of the `pathlib.Path` interface that readers use. Read-only.

An episode of a shard is small; `open` reads it as a whole.
"""

from __future__ import annotations

import errno
import io
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from schemas.encoding.container import local_header_bytes, read_local_header
from schemas.storage.object_path import ObjectPath, Stat


@dataclass(frozen=True, slots=True)
class PackedPath:
    """Path of a file that is stored as a member of a shard; can be pickled."""

    shard: Path | ObjectPath
    """Path of the shard."""
    name: str
    """Name of the member, e.g. `ep_000001.zip`."""
    offset: int
    """Offset of the first byte of the file in the shard."""
    size: int
    """Size of the file, bytes."""

    @property
    def stem(self) -> str:
        return self.name.rpartition(".")[0]

    @property
    def parent(self) -> Path | ObjectPath:
        """Folder of the shard, which would contain the file if it were not packed."""
        return self.shard.parent

    @property
    def parents(self) -> Sequence[Path | ObjectPath]:
        """All folders that contain the shard, the innermost first."""
        return self.shard.parents

    def open(self, mode: Literal["rb"] = "rb") -> io.BytesIO:
        """Opens the file for reading; see `read_bytes` for the errors."""
        assert mode == "rb"
        return io.BytesIO(self.read_bytes())

    def read_bytes(self, *, checked: bool = True) -> bytes:
        """Returns the content of the file.

        Args:
            checked: whether to check the header of the file in the shard; otherwise the bytes at the offset are
                returned.

        Raises:
            FileNotFoundError: the shard does not exist, or the shard has other content at this offset.
            OSError: the shard cannot be read.
            WorldError: the store does not answer.
        """
        if not checked:
            return self._read(self.offset, self.offset + self.size)
        begin = self.offset - local_header_bytes(self.name)
        data = self._read(begin, self.offset + self.size) if begin >= 0 else b""
        if not self._is_mine(data) or len(data) != self.offset + self.size - begin:
            raise FileNotFoundError(errno.ENOENT, "the shard has other content there", str(self))
        return data[self.offset - begin :]

    def stream(self) -> Iterator[bytes]:
        yield self.read_bytes()

    def stat(self) -> Stat:
        """Returns the size of the file according to the directory of the shard; reads nothing."""
        return Stat(self.size)

    def is_file(self) -> bool:
        """Returns whether the shard has the file at the offset; reads the header of the file."""
        begin = self.offset - local_header_bytes(self.name)
        try:
            return begin >= 0 and self._is_mine(self._read(begin, self.offset))
        except OSError:
            return False

    exists = is_file

    def is_symlink(self) -> bool:
        """Returns False; a shard has no links."""
        return False

    def _is_mine(self, data: bytes) -> bool:
        # a coordinator that is killed before it writes the index, or a restored backup, leaves an outdated index
        header = read_local_header(data)
        return header is not None and (header.name, header.size) == (self.name, self.size)

    def _read(self, begin: int, end: int) -> bytes:
        if isinstance(self.shard, ObjectPath):
            return self.shard.objects.read_range(self.shard.key, begin, end)
        # a Python file object would double the time of the read
        descriptor = os.open(self.shard, os.O_RDONLY | os.O_CLOEXEC)
        try:
            return os.pread(descriptor, end - begin, begin)
        finally:
            os.close(descriptor)

    def __str__(self) -> str:
        return f"{self.shard}/{self.name}"
