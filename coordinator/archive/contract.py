"""The archive: what the one writer of a dataset promises, wherever the dataset is stored. Keeps nothing itself.

Design: docs/design/data.md#archive.

`open_archive` opens one; `tests/contract/test_archives.py` holds every kind of archive to this page.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Protocol

from coordinator.archive.staged import Staged
from schemas.job import episode_id
from schemas.storage.place import Place

__all__ = [
    "Archive",
    "Staged",
    "index_of_file",
    "scene_file",
]

_EPISODE_FILE = re.compile(r"ep_(\d{6,7})\.zip")


def scene_file(name: str, sha256: str) -> str:
    """Returns the name of a compiled scene's file among the scenes."""
    return f"{name}-{sha256[:16]}.scene.zip"


def index_of_file(name: str) -> int | None:
    """Returns the episode number in a file name, or `None` when it is no name of an episode."""
    match = _EPISODE_FILE.fullmatch(name)
    if match is None:
        return None
    index = int(match[1])
    return index if index >= 1 and name == f"{episode_id(index)}.zip" else None


class Archive(AbstractContextManager["Archive", None], Protocol):
    """An opened dataset; while it is open no other coordinator can open it."""

    @property
    def root(self) -> Place:
        """Where the dataset lies."""

    def stage(self, index: int) -> Staged:
        """Opens a new part file for an episode; several may be open for one episode.

        Raises:
            WorldError: the disk is full or gone.
        """

    def publish(self, staged: Staged, index: int) -> Place:
        """Gives a part file its final name, durably. The ledger commits after this.

        Raises:
            ArchiveCorrupt: something else lies there; it is left as it is, the part file is removed.
            WorldError: it cannot be kept; nothing half written has a name.
        """

    def path_of(self, index: int) -> Place:
        """Returns where the episode of that number lies, or will lie."""

    def present(self) -> Mapping[int, Place]:
        """Returns the episodes that lie there, by number in ascending order; says nothing of their contents."""

    def foreign(self) -> Sequence[Place]:
        """Returns what lies among the episodes and is none by its name."""

    def unpublish(self, index: int) -> None:
        """Deletes an episode that the ledger does not own; does nothing when there is none."""

    def quarantine(self, path: Place, reason: str) -> Place:
        """Moves a file out of the dataset, keeps it, and writes beside it why; returns where it lies now."""

    def restore(self, path: Place, index: int) -> Place:
        """Moves a file out of quarantine to where the episode of that number lies, durably; returns that place.

        Raises:
            ArchiveCorrupt: something else is there.
        """

    def free_bytes(self) -> int:
        """Returns the bytes that an ordinary user can still write where part files grow."""

    def add_scene(self, source: Path, name: str, sha256: str) -> Place:
        """Keeps a compiled scene beside the episodes made in it; does nothing when it lies there already.

        Raises:
            ArchiveCorrupt: the package has another digest than it must have.
        """

    def scene_path(self, name: str, sha256: str) -> Place:
        """Returns where a compiled scene lies, or will lie."""

    def replacing(self, name: str) -> AbstractContextManager[Path]:
        """Yields a part file that replaces a table of the dataset once the block is left without error.

        Raises:
            WorldError: it cannot be written; the former file is still there, whole.
        """

    def close(self) -> None:
        """Lets another coordinator open the dataset."""
