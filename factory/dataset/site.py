"""Where a run works: the place of its dataset, and the local directory of what can lie on a disk only.

For a directory both are one. A dataset in object storage has a home among this user's state: ledger, part files, spool
and lock; the same URL finds it again.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from pathlib import Path

from factory.support.settings import state_directory, store_endpoint
from schemas.storage.object_path import ObjectPath
from schemas.storage.place import Place, place_of

__all__ = ["Site", "site_of"]


@dataclass(frozen=True)
class Site:
    """Both places; spelt as the user gives it."""

    place: Place
    """Of the dataset."""
    home: Path
    """Of the ledger and whatever else a coordinator keeps on a disk."""

    @property
    def store(self) -> ObjectPath | None:
        """The place, when it is in object storage."""
        return self.place if isinstance(self.place, ObjectPath) else None

    def __str__(self) -> str:
        return str(self.place)


def site_of(name: str | Place) -> Site:
    """Returns where the run of a directory or URL works.

    Raises:
        UsageError: the URL cannot be understood, or the extra for object storage is not installed.
    """
    place = place_of(name)
    return Site(place, place if isinstance(place, Path) else _home_of(place))


def _home_of(place: ObjectPath) -> Path:
    # the same bucket name on two servers is two datasets
    whole = f"{place} {store_endpoint()}"
    readable = re.sub(r"[^A-Za-z0-9_-]+", "-", str(place).partition("://")[2])[-40:].strip("-")
    return state_directory() / "archives" / f"{readable}-{hashlib.sha256(whole.encode()).hexdigest()[:16]}"
