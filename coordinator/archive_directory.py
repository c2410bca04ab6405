"""The archive as a directory: every step is durable before the next one begins (DESIGN 5, notes/zenoh.md C2).

Never overwrites an episode, never derives a path from a name it was given, never reads what a bundle holds.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import secrets
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

import structlog

from coordinator.archive import EPISODES, QUARANTINE, SCENES, STAGING, index_of_file
from coordinator.disk import copy_hashed, sync_directory, sync_file, translated, world_error
from coordinator.staged import Staged
from coordinator.summary import file_name_of
from schemas.errors import ArchiveCorrupt, WorldError
from schemas.job import episode_id

__all__ = ["DirectoryArchive"]

_LOCK = ".lock"
log = structlog.get_logger(__name__)


class DirectoryArchive:
    """An opened dataset directory; while it is open no other coordinator can open it.

    Raises:
        WorldError: the directory cannot be written, or another coordinator works on it.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self._publishing = threading.Lock()
        try:
            root.mkdir(parents=True, exist_ok=True)
            self._lock = _lock(root / _LOCK)
        except OSError as error:
            raise world_error("open", root, error) from error
        try:
            for name in (EPISODES, SCENES, STAGING, QUARANTINE):
                (root / name).mkdir(exist_ok=True)
            _clear(root / STAGING)
            sync_directory(root)
        except OSError as error:
            os.close(self._lock)
            raise world_error("open", root, error) from error

    def stage(self, index: int) -> Staged:
        """Opens a new part file for an episode; several may be open for one episode.

        Raises:
            WorldError: the directory cannot be written.
        """
        path = self.root / STAGING / f"{episode_id(index)}.{secrets.token_hex(8)}.part"
        try:
            return Staged(path, path.open("xb", buffering=0))
        except OSError as error:
            raise world_error("write", path.parent, error) from error

    def publish(self, staged: Staged, index: int) -> Path:
        """Gives a part file its final name: fsync, rename, fsync directory. The ledger commits after this.

        Raises:
            ArchiveCorrupt: a file of that name lies there; it is left as it is, the part file is removed.
            WorldError: the disk is full or gone; nothing half written remains.
        """
        final = self.path_of(index)
        staged.flush()
        with self._publishing, staged:
            if final.exists():
                raise ArchiveCorrupt(f"{final} lies there already and is not overwritten: run `factory verify --deep`")
            try:
                staged.path.rename(final)
                sync_directory(final.parent)
            except OSError as error:
                raise world_error("rename into", final.parent, error) from error
        return final

    def path_of(self, index: int) -> Path:
        """Returns where the episode of that number lies, or will lie."""
        return self.root / file_name_of(episode_id(index))

    def present(self) -> dict[int, Path]:
        """Returns the episodes that lie there, by number in ascending order; says nothing of their contents."""
        found = {index: path for index, path in self._listing() if index is not None}
        return dict(sorted(found.items()))

    def foreign(self) -> list[Path]:
        """Returns what lies among the episodes and is none by its name."""
        return sorted(path for index, path in self._listing() if index is None)

    def _listing(self) -> Iterator[tuple[int | None, Path]]:
        with os.scandir(self.root / EPISODES) as entries:
            for entry in entries:
                is_file = entry.is_file(follow_symlinks=False)
                yield index_of_file(entry.name) if is_file else None, Path(entry.path)

    def unpublish(self, index: int) -> None:
        """Deletes an episode that the ledger does not own; does nothing when there is none."""
        path = self.path_of(index)
        with self._publishing, translated("delete from", path.parent):
            path.unlink(missing_ok=True)
            sync_directory(path.parent)

    def quarantine(self, path: Path, reason: str) -> Path:
        """Moves a file or directory out of the dataset, keeps it, and writes beside it why.

        Returns:
            Where it lies now.
        """
        place = self.root / QUARANTINE / f"{path.name}.{secrets.token_hex(4)}"
        with translated("move into", place.parent):
            path.rename(place)
            place.with_name(f"{place.name}.reason.txt").write_text(f"{path}\n{reason}\n", encoding="utf-8")
            sync_directory(place.parent)
            sync_directory(path.parent)
        log.warning("quarantined", file=str(path), moved_to=str(place), reason=reason)
        return place

    def free_bytes(self) -> int:
        """Returns the bytes an ordinary user can still write to the archive's file system."""
        with translated("ask the free space of", self.root):
            return shutil.disk_usage(self.root).free

    def add_scene(self, source: Path, name: str, sha256: str) -> Path:
        """Keeps a compiled scene beside the episodes made in it; does nothing when it lies there already.

        Args:
            source: the compiled package.
            name: of the scene.
            sha256: digest that the package must have.

        Raises:
            ArchiveCorrupt: the package has another digest.
        """
        final = self.scene_path(name, sha256)
        if final.exists():
            return final
        part = self.root / STAGING / f"scene.{secrets.token_hex(8)}.part"
        try:
            with translated("write", part.parent):
                found = copy_hashed(source, part)
                if found != sha256:
                    raise ArchiveCorrupt(f"{source} has SHA-256 {found}, expected {sha256}: build the scene again")
                part.replace(final)
                sync_directory(final.parent)
        finally:
            part.unlink(missing_ok=True)
        return final

    def scene_path(self, name: str, sha256: str) -> Path:
        """Returns where a compiled scene lies, or will lie."""
        return self.root / SCENES / f"{name}-{sha256[:16]}.scene.zip"

    @contextlib.contextmanager
    def replacing(self, name: str) -> Iterator[Path]:
        """Yields the path of a part file that replaces a table of the dataset once the block is left without error.

        Args:
            name: of a file in the dataset's own directory, e.g. `metadata.parquet`.

        Raises:
            WorldError: the disk is full or gone; the former file is still there, whole.
        """
        part = self.root / STAGING / f"{name}.{secrets.token_hex(8)}.part"
        try:
            with translated("write", self.root / name):
                yield part
                sync_file(part)
                part.replace(self.root / name)
                sync_directory(self.root)
        finally:
            part.unlink(missing_ok=True)

    def close(self) -> None:
        """Lets another coordinator open the directory."""
        os.close(self._lock)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _lock(path: Path) -> int:
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        owner = os.pread(descriptor, 32, 0).decode("ascii", "replace").strip() or "unknown"
        os.close(descriptor)
        message = f"another coordinator works on {path.parent} (pid {owner}): stop it first, or choose another --out"
        raise WorldError(message) from error
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, f"{os.getpid()}\n".encode(), 0)
    return descriptor


def _clear(directory: Path) -> None:
    for path in directory.iterdir():
        if path.is_file() or path.is_symlink():
            path.unlink()
