"""Opens the archive of a dataset in a directory or in object storage. Stores no data itself."""

from __future__ import annotations

from pathlib import Path

from coordinator.archive.contract import Archive
from coordinator.archive.directory import DirectoryArchive
from coordinator.archive.objects import ObjectArchive
from schemas.storage.object_path import ObjectPath


def open_archive(root: Path, store: ObjectPath | None = None, *, take_over: bool = False) -> Archive:
    """Opens a dataset exclusively for writing; the archive is a context manager.

    Args:
        root: dataset directory, or with `store` the state directory; created if it does not exist.
        store: root of the dataset in object storage; `None` for a dataset in a directory.
        take_over: whether to take over a dataset in object storage from the state directory that holds it.

    Raises:
        WorldError: the directory or the store cannot be written, or another coordinator holds the dataset.
    """
    return DirectoryArchive(root) if store is None else ObjectArchive(store, root, take_over=take_over)
