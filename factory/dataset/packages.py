"""Provides compiled scenes of a dataset as local files; downloads those of a remote dataset once and caches them."""

from __future__ import annotations

import secrets
from pathlib import Path

from factory.support.settings import cache_directory
from schemas.storage.disk import translated
from schemas.storage.place import Place, digest_of

__all__ = ["package_file"]


def package_file(place: Place) -> Path:
    """Returns the local file of a scene package; the digest in its name identifies a cached copy.

    Raises:
        FileNotFoundError: The package does not exist.
        WorldError: The object store does not respond, or the cache cannot be written.
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
