"""Defines the `Archive` interface and the base class of both implementations. Stores no data.

Design: docs/design/data.md#archive.

`open_archive` opens an archive; `tests/contract/test_archives.py` tests every implementation against this interface.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from coordinator.archive.staging import Staged
from schemas.storage.object_path import ObjectPath
from schemas.storage.place import Place

__all__ = ["Archive", "Listing", "Staged", "scene_file"]

P = TypeVar("P", Path, ObjectPath)


def scene_file(name: str, sha256: str) -> str:
    """Returns the file name of a compiled scene in the scene folder."""
    return f"{name}-{sha256[:16]}.scene.zip"


class Archive(AbstractContextManager["Archive", None], Protocol):
    """Exclusively opened dataset: no other coordinator can open it until it is closed."""

    @property
    def root(self) -> Place:
        """Root path of the dataset."""

    def stage(self, index: int) -> Staged:
        """Opens a new part file for an episode. An episode may have several open part files.

        Raises:
            WorldError: the disk is full or unavailable.
        """

    def publish(self, staged: Staged, index: int) -> Place:
        """Publishes a part file durably under its final name. The ledger commits afterwards.

        Raises:
            ArchiveCorrupt: a different file has that name; it is not changed, and the part file is removed.
            WorldError: the file cannot be stored; no incomplete file is published.
        """

    def path_of(self, index: int) -> Place:
        """Returns the path of an episode, whether or not the episode is archived yet."""

    def present(self) -> Mapping[int, Place]:
        """Returns the paths of the stored episodes by number, ascending. Does not read their contents."""

    def foreign(self) -> Sequence[Place]:
        """Returns the paths in the episode folder that do not have an episode's file name."""

    def unpublish(self, index: int) -> None:
        """Deletes an episode that the ledger does not own. Does nothing if the file does not exist."""

    def quarantine(self, path: Place, reason: str) -> Place:
        """Moves a file to the quarantine folder, writes the reason to a file beside it, and returns the new path."""

    def restore(self, path: Place, index: int) -> Place:
        """Moves a file durably from the quarantine folder to the path of an episode, and returns that path.

        Raises:
            ArchiveCorrupt: another file has that path.
        """

    def free_bytes(self) -> int:
        """Returns the free space, in bytes, for an unprivileged user on the file system of the part files."""

    def add_scene(self, source: Path, name: str, sha256: str) -> Place:
        """Stores a compiled scene with the dataset. Does nothing if the scene is already stored.

        Raises:
            ArchiveCorrupt: the digest of the package differs from `sha256`.
        """

    def scene_path(self, name: str, sha256: str) -> Place:
        """Returns the path of a compiled scene, whether or not it is stored yet."""

    def replacing(self, name: str) -> AbstractContextManager[Path]:
        """Yields a part file, which replaces a table of the dataset if the block exits without an error.

        Raises:
            WorldError: the file cannot be written; the previous file is unchanged.
        """

    def close(self) -> None:
        """Releases the dataset, so that another coordinator can open it."""


class Listing(ABC, Generic[P]):
    """Base class of archives: listing of the episode folder, independent of the storage."""

    @abstractmethod
    def _listing(self) -> Iterator[tuple[int | None, P]]:
        """Yields the paths in the episode folder in any order, each with its episode number or `None`."""

    def present(self) -> dict[int, P]:
        """Returns the paths of the stored episodes by number, ascending. Does not read their contents."""
        return dict(sorted((index, path) for index, path in self._listing() if index is not None))

    def foreign(self) -> list[P]:
        """Returns the paths in the episode folder that do not have an episode's file name."""
        return sorted(path for index, path in self._listing() if index is None)
