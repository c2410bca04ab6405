"""Defines the `Archive` interface. Stores no data.

Design: docs/design/data.md#archive.

`open_archive` opens an archive; `tests/contract/test_archives.py` tests every implementation against this interface.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Protocol

from coordinator.archive.scenes import scene_file
from coordinator.archive.staging import PartFile
from schemas.errors import FactoryError
from schemas.storage.place import FilePlace, Place

__all__ = ["Archive", "PartFile", "scene_file"]


class Archive(AbstractContextManager["Archive", None], Protocol):
    """Exclusively opened dataset: no other coordinator can open it until it is closed."""

    @property
    def root(self) -> Place:
        """Root path of the dataset."""

    def stage(self, index: int) -> PartFile:
        """Opens a new part file for an episode. An episode may have several open part files.

        Raises:
            WorldError: the disk is full or unavailable.
        """

    def publish(self, staged: PartFile, index: int) -> Place:
        """Publishes a part file durably under its final name. The ledger commits afterwards.

        Raises:
            ArchiveCorrupt: a different file has that name; it is not changed, and the part file is removed.
            WorldError: the file cannot be stored; no incomplete file is published.
        """

    def publish_all(self, parts: Mapping[int, PartFile]) -> Mapping[int, FactoryError]:
        """Publishes the part files of several episodes, as `publish` does, and syncs them together.

        Returns:
            The error of each episode that was not published, by episode number; all other episodes are published.

        Raises:
            WorldError: the folder cannot be synced; the ledger must record none of the episodes.
        """

    def path_of(self, index: int) -> FilePlace:
        """Returns the path of an episode, whether or not the episode is archived yet."""

    def present(self) -> Mapping[int, FilePlace]:
        """Returns the paths of the stored episodes by number, ascending. Does not read their contents."""

    def unpacked(self) -> Mapping[int, Place]:
        """Returns the paths of the unpacked episodes by episode number, ascending."""

    def foreign(self) -> Sequence[Place]:
        """Returns the paths in the episode folder that are neither episodes nor shards."""

    def shards(self) -> Sequence[str]:
        """Returns the file names of the shards, sorted."""

    def pack(self, owned: Mapping[int, str], first: int, last: int) -> int:
        """Moves episodes of one range of numbers from their files into a new shard, durably.

        Skips a file that is too large, missing or damaged, with a warning that names it.

        Args:
            owned: SHA-256 of each episode to pack, by number.
            first: first number of the range.
            last: last number of the range.

        Returns:
            The number of packed episodes.

        Raises:
            WorldError: the disk is full or unavailable; no episode is lost.
        """

    def write_shard_index(self) -> None:
        """Writes `shards.parquet`, which lists the place of each packed episode.

        Raises:
            WorldError: the file cannot be written; the previous file is unchanged.
        """

    def unpublish(self, index: int) -> None:
        """Deletes an episode that the ledger does not record. Does nothing if the episode does not exist."""

    def quarantine(self, path: FilePlace, reason: str) -> Place:
        """Moves a file to the quarantine folder, writes the reason to a file beside it, and returns the new path.

        A packed episode is copied there, and its shard is replaced by one without the episode.
        """

    def restore(self, path: Place, index: int) -> Place:
        """Moves a file durably from the quarantine folder to the path of an episode, and returns that path.

        Raises:
            ArchiveCorrupt: another file has that path.
        """

    def free_bytes(self) -> int:
        """Returns the free space, in bytes, for an unprivileged user on the file system of the part files."""

    def add_scene(self, source: Path, name: str, sha256: str, textures: Sequence[str] = ()) -> Place:
        """Stores a compiled scene with the dataset, its textures first. Does nothing if the scene is already stored.

        Args:
            source: compiled package; the textures that the dataset does not have are in the folder beside it.
            name: name of the scene.
            sha256: expected SHA-256 of the package.
            textures: SHA-256 of the files of its textures.

        Raises:
            ArchiveCorrupt: the digest of the package differs from `sha256`, or a texture is missing or damaged.
            WorldError: the file cannot be stored; no incomplete file is published.
        """

    def add_texture(self, source: Path, sha256: str) -> Place:
        """Stores the file of a texture. Does nothing if it is stored already; raises the errors of `add_scene`."""

    def scene_path(self, name: str, sha256: str) -> Place:
        """Returns the path of a compiled scene, whether or not it is stored yet."""

    def texture_path(self, sha256: str) -> Place:
        """Returns the path of the file of a texture, whether or not it is stored yet."""

    def sweep_textures(self, needed: Collection[str]) -> None:
        """Deletes the textures whose SHA-256 is not in `needed`; an interruption can leave such textures."""

    def replacing(self, name: str) -> AbstractContextManager[Path]:
        """Yields a part file, which replaces a table of the dataset if the block exits without an error.

        Raises:
            WorldError: the file cannot be written; the previous file is unchanged.
        """

    def close(self) -> None:
        """Releases the dataset, so another coordinator can open it."""
