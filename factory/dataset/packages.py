"""Compiled scenes of a dataset as files of this machine: those of a dataset far away are fetched once and cached."""

from __future__ import annotations

import secrets
from pathlib import Path

from factory.support.settings import cache_directory
from schemas.storage.disk import translated
from schemas.storage.place import Place, digest_of

__all__ = ["package_file"]


def package_file(place: Place) -> Path:
    """Returns the file of a package; its name holds the digest's beginning, by which a cached copy is known.

    Raises:
        FileNotFoundError: there is no such package.
        WorldError: the store does not answer, or the cache cannot be written.
    """
    if isinstance(place, Path):
        return place
    folder = cache_directory() / "packages"
    copy = folder / place.name
    if copy.is_file() and f"-{digest_of(copy)[:16]}." in copy.name:
        return copy
    part = folder / f"{place.name}.{secrets.token_hex(8)}.part"
    with translated("write", folder):
        folder.mkdir(parents=True, exist_ok=True)
    try:
        data = place.read_bytes()
        with translated("write", part):
            part.write_bytes(data)
            part.replace(copy)
    finally:
        part.unlink(missing_ok=True)
    return copy
