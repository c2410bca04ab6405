"""Paths in object storage, with the part of the `pathlib.Path` interface that readers of a dataset use. Read-only.

A folder is a common prefix of keys; a folder without objects does not exist.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import PurePosixPath
from typing import Any, BinaryIO, Literal, NamedTuple

from schemas.storage.object_store import Objects, objects_at

_READ_AHEAD_BYTES = 1 << 20
"""Size of a range request, bytes. It covers one frame of the largest scene or twenty frames of the smallest, so the
three images of a frame need at most one request together."""
_TAIL_BYTES = 512 << 10
"""Size of the request for the end of a file, bytes. It covers directory, metadata and arrays of an episode of 1000
frames, so one request opens it."""


class Stat(NamedTuple):
    """Part of `os.stat_result` that paths in object storage and in shards have."""

    st_size: int
    """Size of the file, bytes."""


class ObjectPath:
    """Path of an object or a folder of objects; compares and sorts by URL, and can be pickled."""

    def __init__(self, objects: Objects, key: str = "", size: int | None = None) -> None:
        """Creates a path; sends no request.

        Args:
            objects: the store.
            key: key below the store's URL; empty for the root folder.
            size: size in bytes, if a listing contained it.
        """
        self.objects = objects
        self.key = key
        self._size = size

    @classmethod
    def at(cls, url: str) -> ObjectPath:
        """Returns the path of a URL.

        Raises:
            UsageError: the URL is not valid, or `obstore` is not installed.
        """
        return cls(objects_at(url))

    @property
    def name(self) -> str:
        """Last component of the key, or of the URL for the root folder."""
        return str(self).rsplit("/", 1)[1]

    @property
    def stem(self) -> str:
        """The name without its last suffix."""
        return PurePosixPath(self.name).stem

    @property
    def parent(self) -> ObjectPath:
        """Folder that contains the path; the root folder is its own parent."""
        return ObjectPath(self.objects, self.key.rpartition("/")[0])

    @property
    def parents(self) -> tuple[ObjectPath, ...]:
        """All folders that contain the path, the innermost first."""
        return tuple(ObjectPath(self.objects, "" if key == "." else key) for key in map(str, _parents(self.key)))

    def __truediv__(self, name: str) -> ObjectPath:
        return ObjectPath(self.objects, f"{self.key}/{name}" if self.key else name)

    def open(self, mode: Literal["rb"] = "rb") -> BinaryIO:
        """Opens an object for reading; its content is fetched on demand.

        Raises:
            FileNotFoundError: the object does not exist.
            WorldError: the store does not answer.
        """
        assert mode == "rb"
        return io.BufferedReader(_Ranges(self.objects, self.key))

    def stream(self) -> Iterator[bytes]:
        """Yields the content of an object in pieces, with one request."""
        return self.objects.stream(self.key)

    def read_bytes(self) -> bytes:
        return self.objects.read(self.key)

    def read_text(self, encoding: str = "utf-8") -> str:
        return self.read_bytes().decode(encoding)

    def stat(self) -> Stat:
        """Returns the size of an object, from the listing that contained it or else from the store."""
        return Stat(self.objects.head(self.key).size if self._size is None else self._size)

    def is_file(self) -> bool:
        """Returns whether the path is an object; sends no request for a path from a listing."""
        try:
            self.stat()
        except FileNotFoundError:
            return False
        return True

    exists = is_file

    def is_symlink(self) -> bool:
        """Returns False; object storage has no links."""
        return False

    def is_dir(self) -> bool:
        """Returns whether the path is a folder, which contains at least one object."""
        return next(self.walk(), None) is not None

    def iterdir(self) -> Iterator[ObjectPath]:
        """Yields the folders and the objects in a folder, objects with their sizes; nothing if it does not exist."""
        folders, files = self.objects.list_folder(self.key)
        yield from (ObjectPath(self.objects, key) for key in folders)
        yield from (ObjectPath(self.objects, listed.key, listed.size) for listed in files)

    def walk(self, after: str = "") -> Iterator[ObjectPath]:
        """Yields all objects below a folder, recursively, with their sizes.

        Args:
            after: name in the folder; objects whose keys precede it are omitted.
        """
        listing = self.objects.walk(self.key, f"{self.key}/{after}" if after else None)
        return (ObjectPath(self.objects, one.key, one.size) for one in listing)

    def glob(self, pattern: str) -> Iterator[ObjectPath]:
        """Yields the entries of the folder whose name matches a pattern."""
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
    """File object over an object in the store; reads ranges, and keeps the last range in memory."""

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
