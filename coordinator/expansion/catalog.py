"""The compiled scenes a run uses: what plan expansion draws from and what workers fetch. Holds, never builds."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from schemas.scene import SceneInfo, decode_scene

__all__ = ["Catalog", "SceneEntry", "read_entry"]


@dataclass(frozen=True)
class SceneEntry:
    """One compiled scene on disk."""

    info: SceneInfo
    sha256: str
    """Digest of the package file; its name on the wire."""
    size: int
    """Bytes of the package file."""
    path: Path


Catalog = Mapping[str, SceneEntry]
"""Scene name -> entry."""


def read_entry(path: Path) -> SceneEntry:
    """Reads a package's digest and metadata.

    Raises:
        InvalidBundle: the file is no package of this format version.
    """
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
        size = file.tell()
        return SceneEntry(decode_scene(file).info, sha256, size, path)
