"""Lists the episode folder of an archive: episodes by number, and foreign files. Does not read file contents."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import Generic, TypeVar

from schemas.storage.object_path import ObjectPath

__all__ = ["Listing"]

P = TypeVar("P", Path, ObjectPath)


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
