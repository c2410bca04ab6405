"""Describes the compiled scenes of a run, which plan expansion samples from and workers fetch. Compiles no scene."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from schemas.scene import SceneInfo, decode_scene
from schemas.storage.place import digest_of
from schemas.view import LightFile


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
    light: Path | None = None
    """Path of the light groups of the scene, if the plan varies the light."""

    @functools.cached_property
    def light_file(self) -> LightFile | None:
        """Digest and size of the light groups."""
        if self.light is None:
            return None
        return LightFile(sha256=digest_of(self.light), size=self.light.stat().st_size)

    @property
    def files(self) -> dict[str, Path]:
        """Files that workers fetch, by digest."""
        light = {} if self.light is None or self.light_file is None else {self.light_file.sha256: self.light}
        return {self.sha256: self.path, **light}


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
