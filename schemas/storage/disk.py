"""Durable file operations, and error messages with remedies for file system errors. Independent of datasets."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path

from schemas.errors import WorldError

_REMEDIES = {
    errno.ENOSPC: "free some space or choose another --out; the run resumes where it stopped",
    errno.EDQUOT: "the quota is used up: free some space or choose another --out",
    errno.EROFS: "the file system is read-only: choose another --out",
    errno.EACCES: "the directory may not be written: change its permissions or choose another --out",
    errno.EPERM: "the directory may not be written: change its permissions or choose another --out",
    errno.ENOTDIR: "the path is a file, not a directory: choose another --out",
    errno.EEXIST: "the path is a file, not a directory: choose another --out",
}


def free_bytes(root: Path) -> int:
    """Returns the free space of the file system of a directory, which need not exist yet, bytes.

    Raises:
        WorldError: the file system cannot be read.
    """
    there = next(place for place in (root.absolute(), *root.absolute().parents) if place.exists())
    with translated("read the free space of", there):
        return shutil.disk_usage(there).free


def require_room(root: Path, reserve_bytes: int) -> None:
    """Checks that the file system of a directory, which need not exist yet, has enough free space; creates nothing.

    Args:
        root: the directory.
        reserve_bytes: required free space, bytes.

    Raises:
        WorldError: less space is free.
    """
    free = free_bytes(root)
    if free < reserve_bytes:
        raise WorldError(
            f"{root} has {free / 1e9:.2f} GB free, but a run keeps {reserve_bytes / 1e9:.2f} GB in reserve: free some "
            "space or choose another --out"
        )


def set_aside(path: Path, folder: Path, reason: str) -> Path:
    """Moves a file or directory into a folder under a unique name, and writes the reason to a file beside it.

    Returns:
        The new path.

    Raises:
        WorldError: the file or directory cannot be moved.
    """
    place = folder / f"{path.name}.{secrets.token_hex(4)}"
    with translated("move into", folder):
        path.rename(place)
        _explain(place, str(path), reason)
        sync_directory(path.parent)
    return place


def set_copy_aside(data: bytes, origin: str, folder: Path, reason: str) -> Path:
    """Writes the content of a file into a folder under a unique name, and the reason to a file beside it.

    Args:
        data: content of the file.
        origin: path of the file, which need not be a path of the file system.
        folder: folder of the copy.
        reason: why the file is set aside.

    Returns:
        The path of the copy.

    Raises:
        WorldError: the folder cannot be written.
    """
    place = folder / f"{origin.rpartition('/')[2]}.{secrets.token_hex(4)}"
    with replacing(place, durable=True) as part:
        part.write_bytes(data)
    with translated("write into", folder):
        _explain(place, origin, reason)
    return place


def _explain(place: Path, origin: str, reason: str) -> None:
    """Writes the origin and the reason to a file beside a quarantined file, and logs them."""
    place.with_name(f"{place.name}.reason.txt").write_text(f"{origin}\n{reason}\n", encoding="utf-8")
    sync_directory(place.parent)
    import structlog  # imported here, because it would slow down the start of each process that reads a dataset

    structlog.get_logger(__name__).warning("quarantined", file=origin, moved_to=str(place), reason=reason)


def sync_file(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_directory(path: Path) -> None:
    """Syncs the entries of a directory to disk."""
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def replacing(path: Path, *, part: Path | None = None, durable: bool = False) -> Iterator[Path]:
    """Yields the path of a part file, which replaces `path` if the block exits without an error.

    Args:
        path: the file; its folder exists.
        part: path of the part file; by default a hidden file beside `path`.
        durable: whether to sync file and folder to disk.

    Raises:
        WorldError: the file cannot be written; the previous file is unchanged.
    """
    part = part or path.with_name(f".{path.name}.part")
    try:
        with translated("write", path):
            yield part
            if durable:
                sync_file(part)
            part.replace(path)
            if durable:
                sync_directory(path.parent)
    finally:
        with contextlib.suppress(OSError):  # the folder may not exist
            part.unlink()


@contextlib.contextmanager
def translated(what: str, where: object) -> Iterator[None]:
    """Converts an `OSError` of the block to a `WorldError` that names the path and the remedy."""
    try:
        yield
    except OSError as error:
        raise world_error(what, where, error) from error


def world_error(what: str, where: object, error: OSError) -> WorldError:
    """Returns the error to raise: `cannot <what> <where>`, the reason and the remedy."""
    remedy = _REMEDIES.get(error.errno or 0, "check the disk, or choose another --out")
    return WorldError(f"cannot {what} {where}: {error.strerror or error}; {remedy}")
