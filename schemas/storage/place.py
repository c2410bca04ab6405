"""Location of a dataset: a directory, or a folder in object storage, with one interface for readers. Read-only."""

from __future__ import annotations

import contextlib
import hashlib
import tempfile
from collections.abc import Iterator
from io import BufferedReader, BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias
from urllib.parse import unquote, urlsplit

from schemas.errors import UsageError
from schemas.storage.disk import translated
from schemas.storage.object_path import ObjectPath
from schemas.storage.packed_path import PackedPath
from schemas.support.foreign import path_trouble

if TYPE_CHECKING:
    from pyarrow import BufferReader

Place: TypeAlias = Path | ObjectPath
"""File or folder of a dataset."""
FilePlace: TypeAlias = Path | ObjectPath | PackedPath
"""File of a dataset, which may be packed in a shard."""


def place_of(name: str | Place) -> Place:
    """Returns the path object for a path or a URL; `file://` is a local directory.

    Raises:
        UsageError: the path or URL is not valid, or the extra for object storage is not installed.
    """
    if not isinstance(name, str):
        return name
    if name.startswith("file:"):
        parts = urlsplit(name)
        if parts.netloc not in ("", "localhost") or not parts.path.startswith("/"):
            raise UsageError(f"{name!r} is not a local directory: write file:///DIRECTORY")
        return _path(unquote(parts.path))
    return ObjectPath.at(name) if "://" in name else _path(name)


def _path(name: str) -> Path:
    trouble = path_trouble(name)
    if trouble:
        raise UsageError(f"{name[:80]!r} is not a valid directory: {trouble}")
    return Path(name)


def children(folder: Place) -> list[Place]:
    """Returns the entries of a folder, sorted by name; empty if the folder does not exist."""
    try:
        return sorted(folder.iterdir(), key=lambda place: place.name)
    except FileNotFoundError:
        return []


def relative_name(place: FilePlace, root: Place) -> str:
    """Returns the path of a file relative to its dataset."""
    return str(place).removeprefix(f"{root}/")


def digest_of(place: FilePlace) -> str:
    """Returns the SHA-256 of a file; reads it once and stores no copy."""
    if isinstance(place, Path):
        with place.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    digest = hashlib.sha256()
    for piece in place.stream():
        digest.update(piece)
    return digest.hexdigest()


@contextlib.contextmanager
def local_copy(place: FilePlace) -> Iterator[Path]:
    """Yields the local path of a file: the file itself, or a temporary copy of an object or a packed file.

    Raises:
        FileNotFoundError: the file does not exist.
        WorldError: the store does not answer, or the disk is full.
    """
    if isinstance(place, Path):
        yield place
        return
    with tempfile.TemporaryDirectory(prefix="minivla-") as folder:
        copy = Path(folder) / place.name
        with copy.open("xb") as file:
            for piece in place.stream():
                with translated("copy an episode into", copy.parent):
                    file.write(piece)
        yield copy


@contextlib.contextmanager
def opened(place: FilePlace) -> Iterator[BufferedReader | BytesIO]:
    """Yields an open file with the content of a file: the file itself, a temporary copy of an object, or memory.

    Raises:
        FileNotFoundError: the file does not exist.
        WorldError: the store does not answer, or the disk is full.
    """
    if isinstance(place, PackedPath):
        yield place.open("rb")
        return
    with local_copy(place) as local, local.open("rb") as file:
        yield file


def table_of(place: Place) -> Path | BufferReader:
    """Returns a table file as an argument for `pyarrow`: a local path, or the content of an object in Arrow's memory.

    Not a Python file object: a thread of `pyarrow` that releases one while the interpreter ends aborts the process.

    Raises:
        FileNotFoundError: the object does not exist in the store.
    """
    if isinstance(place, Path):
        return place
    # imported here, because it would slow down the start of each worker
    from pyarrow import BufferOutputStream, BufferReader

    content = BufferOutputStream()
    for piece in place.stream():
        content.write(piece)
    return BufferReader(content.getvalue())
