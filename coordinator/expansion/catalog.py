"""Describes the compiled scenes of a run, which plan expansion samples from and workers fetch. Compiles no scene."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from schemas.scene import SceneInfo, decode_scene


@dataclass(frozen=True)
class SceneEntry:
    """Compiled scene on disk."""

    info: SceneInfo
    """Metadata of the scene."""
    sha256: str
    """SHA-256 of the package file; workers request the package by it."""
    size: int
    """Size of the package file, bytes."""
    path: Path
    """Path of the package file."""


Catalog = Mapping[str, SceneEntry]
"""Mapping of scene name to entry."""


def read_entry(path: Path) -> SceneEntry:
    """Reads digest and metadata of a package.

    Raises:
        InvalidBundle: the file is not a package of this format version.
    """
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
        size = file.tell()
        return SceneEntry(decode_scene(file).info, sha256, size, path)
