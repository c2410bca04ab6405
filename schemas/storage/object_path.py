"""Where an object lies: the part of `pathlib.Path` that readers of a dataset use, over object storage. Reads only.

Folders are what keys have in common; a folder without objects is not there.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import PurePosixPath
from typing import Any, BinaryIO, Literal, NamedTuple

from schemas.storage.object_store import Objects, objects_at

__all__ = ["ObjectPath"]

_READ_AHEAD_BYTES = 1 << 20
"""A frame of the richest scene, or a score of the plainest: a request a frame at most, not three."""
_TAIL_BYTES = 512 << 10
"""Directory, metadata and arrays of an episode of 1000 frames lie within: one request opens it."""


class _Stat(NamedTuple):
    st_size: int


class ObjectPath:
    """An object or a folder of them; compares and sorts by its URL, and travels to other processes."""

    def __init__(self, objects: Objects, key: str = "", size: int | None = None) -> None:
        """Names a place.

        Args:
            objects: the store.
            key: below it; empty for all of it.
            size: in bytes, where a list has said it.
        """
        self.objects = objects
        self.key = key
        self._size = size

    @classmethod
    def at(cls, url: str) -> ObjectPath:
        """Returns the place that a URL names.

        Raises:
            UsageError: the URL cannot be understood, or `obstore` is not installed.
        """
        return cls(objects_at(url))

    @property
    def name(self) -> str:
        """Last part of the key, or of the URL."""
        return str(self).rsplit("/", 1)[1]

    @property
    def stem(self) -> str:
        """The name without its last suffix."""
        return PurePosixPath(self.name).stem

    @property
    def parent(self) -> ObjectPath:
        """The folder it lies in; the store's own is its own parent."""
        return ObjectPath(self.objects, self.key.rpartition("/")[0])

    @property
    def parents(self) -> tuple[ObjectPath, ...]:
        """All folders it lies in, the innermost first."""
        return tuple(ObjectPath(self.objects, "" if key == "." else key) for key in map(str, _parents(self.key)))

    def __truediv__(self, name: str) -> ObjectPath:
        return ObjectPath(self.objects, f"{self.key}/{name}" if self.key else name)

    def open(self, mode: Literal["rb"] = "rb") -> BinaryIO:
        """Opens an object for reading; what is wanted is fetched when it is wanted.

        Raises:
            FileNotFoundError: there is no such object.
            WorldError: the store does not answer.
        """
        assert mode == "rb"
        return io.BufferedReader(_Ranges(self.objects, self.key))

    def stream(self) -> Iterator[bytes]:
        """Yields an object piece by piece, in one request."""
        return self.objects.stream(self.key)

    def read_bytes(self) -> bytes:
        """Returns an object whole."""
        return self.objects.read(self.key)

    def read_text(self, encoding: str = "utf-8") -> str:
        """Returns a text whole."""
        return self.read_bytes().decode(encoding)

    def stat(self) -> _Stat:
        """Returns the size of an object, as the list said that it comes from, else as the store says now."""
        return _Stat(self.objects.head(self.key).size if self._size is None else self._size)

    def is_file(self) -> bool:
        """Whether it is an object: what a list has named is one."""
        try:
            self.stat()
        except FileNotFoundError:
            return False
        return True

    exists = is_file

    def is_symlink(self) -> bool:
        """Whether it is a link: never so."""
        return False

    def is_dir(self) -> bool:
        """Whether objects lie below it."""
        return next(self.walk(), None) is not None

    def iterdir(self) -> Iterator[ObjectPath]:
        """Yields the objects in a folder with their sizes, and the folders in it; none when there is none."""
        folders, files = self.objects.list_folder(self.key)
        yield from (ObjectPath(self.objects, key) for key in folders)
        yield from (ObjectPath(self.objects, found.key, found.size) for found in files)

    def walk(self) -> Iterator[ObjectPath]:
        """Yields all objects below a folder with their sizes, in any depth."""
        return (ObjectPath(self.objects, found.key, found.size) for found in self.objects.walk(self.key))

    def glob(self, pattern: str) -> Iterator[ObjectPath]:
        """Yields what lies in the folder and has a name of that pattern."""
        return (path for path in self.iterdir() if fnmatchcase(path.name, pattern))

    def __str__(self) -> str:
        return f"{self.objects.url}/{self.key}" if self.key else self.objects.url

    def __repr__(self) -> str:
        return f"ObjectPath({str(self)!r})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ObjectPath) and str(self) == str(other)

    def __lt__(self, other: ObjectPath) -> bool:
        return str(self) < str(other)

    def __hash__(self) -> int:
        return hash(str(self))


def _parents(key: str) -> tuple[PurePosixPath, ...]:
    return tuple(PurePosixPath(key).parents)


class _Ranges(io.RawIOBase):
    """An object read by ranges; of what it holds, one piece around the last read is in memory."""

    def __init__(self, objects: Objects, key: str) -> None:
        self._objects, self._key = objects, key
        self._size = objects.head(key).size
        self._position = self._start = 0
        self._piece = b""

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._position

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._position, io.SEEK_END: self._size}[whence]
        if base + offset < 0:
            raise ValueError(f"position {base + offset} is before the beginning of {self._key}")
        self._position = base + offset
        return self._position

    def readinto(self, buffer: Any) -> int:
        if self._position >= self._size:
            return 0
        if not self._start <= self._position < self._start + len(self._piece):
            self._fetch(len(buffer))
        offset = self._position - self._start
        data = memoryview(self._piece)[offset : offset + len(buffer)]
        buffer[: len(data)] = data
        self._position += len(data)
        return len(data)

    def _fetch(self, wanted: int) -> None:
        self._start = min(self._position, max(0, self._size - _TAIL_BYTES))
        end = min(self._size, max(self._start + _READ_AHEAD_BYTES, self._position + wanted))
        self._piece = self._objects.read_range(self._key, self._start, end)
