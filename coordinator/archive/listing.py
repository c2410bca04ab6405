"""What lies among the episodes of an archive: episodes by number, and what is none by its name. Reads no contents."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import Generic, TypeVar

from schemas.storage.object_path import ObjectPath

__all__ = ["Listing"]

P = TypeVar("P", Path, ObjectPath)


class Listing(ABC, Generic[P]):
    """The part of an archive that is the same wherever it lies."""

    @abstractmethod
    def _listing(self) -> Iterator[tuple[int | None, P]]:
        """Yields what lies there in any order, with its number where its name is an episode's."""

    def present(self) -> dict[int, P]:
        """Returns the episodes that lie there, by number in ascending order; says nothing of their contents."""
        return dict(sorted((index, path) for index, path in self._listing() if index is not None))

    def foreign(self) -> list[P]:
        """Returns what lies among the episodes and is none by its name."""
        return sorted(path for index, path in self._listing() if index is None)
