"""Opens the archive of a dataset, by where it lies. Keeps nothing itself."""

from __future__ import annotations

from pathlib import Path

from coordinator.archive import Archive
from coordinator.archive_directory import DirectoryArchive

__all__ = ["open_archive"]


def open_archive(root: Path) -> Archive:
    """Opens a dataset for its one writer; a context manager.

    Args:
        root: dataset directory; it is made when it is not there.

    Raises:
        WorldError: the directory cannot be written, or another coordinator works on it.
    """
    return DirectoryArchive(root)
