"""Opens the archive of a dataset, by where it lies. Keeps nothing itself."""

from __future__ import annotations

from pathlib import Path

from coordinator.archive.contract import Archive
from coordinator.archive.directory import DirectoryArchive
from coordinator.archive.objects import ObjectArchive
from schemas.storage.object_path import ObjectPath

__all__ = ["open_archive"]


def open_archive(root: Path, store: ObjectPath | None = None, *, take_over: bool = False) -> Archive:
    """Opens a dataset for its one writer; a context manager.

    Args:
        root: dataset directory, or with `store` the local home of what cannot lie there; made when it is not there.
        store: where the dataset lies, when in object storage.
        take_over: whether to take a dataset in object storage from the home that holds it.

    Raises:
        WorldError: directory or store cannot be written, or another coordinator works there.
    """
    return DirectoryArchive(root) if store is None else ObjectArchive(store, root, take_over=take_over)
