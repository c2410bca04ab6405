"""Locations of a run: the location of its dataset, and the local state directory.

Both are the same for a dataset in a directory. A dataset in object storage has a state directory in the user's state
folder, derived from the URL; it holds the ledger, part files, the spool and the lock. Creates no directories.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from pathlib import Path

from factory.support.settings import state_directory, store_endpoint
from schemas.errors import UsageError
from schemas.storage.object_path import ObjectPath
from schemas.storage.place import Place, place_of


@dataclass(frozen=True)
class Site:
    """Dataset location and local state directory; `str()` returns the location as the user wrote it."""

    place: Place
    """Location of the dataset, a path or an object storage URL."""
    state_dir: Path
    """Local directory of the ledger and the other files that the coordinator keeps on disk."""

    @property
    def store(self) -> ObjectPath | None:
        """Location of the dataset when it is in object storage, otherwise `None`."""
        return self.place if isinstance(self.place, ObjectPath) else None

    def __str__(self) -> str:
        return str(self.place)


def site_of(name: str | Place) -> Site:
    """Returns the locations of the run for a directory or URL.

    Raises:
        UsageError: The URL is invalid, or the extra for object storage is not installed.
    """
    place = place_of(name)
    return Site(place, place if isinstance(place, Path) else _state_dir_of(place))


def dataset_directory(name: str | Place, command: str) -> Path:
    """Returns the directory of a dataset for a command that does not support object storage.

    Args:
        name: directory, or URL of object storage.
        command: name of the command, for the error message.

    Raises:
        UsageError: the dataset is in object storage, or the URL is invalid.
    """
    place = place_of(name)
    if isinstance(place, Path):
        return place
    raise UsageError(
        f"{command} supports dataset directories only, not {place}: copy the dataset to a local directory first, "
        "for example with `aws s3 sync` or `rclone copy`"
    )


def _state_dir_of(place: ObjectPath) -> Path:
    # the same URL on two servers means two datasets
    whole = f"{place} {store_endpoint()}"
    readable = re.sub(r"[^A-Za-z0-9_-]+", "-", str(place).partition("://")[2])[-40:].strip("-")
    return state_directory() / "archives" / f"{readable}-{hashlib.sha256(whole.encode()).hexdigest()[:16]}"
