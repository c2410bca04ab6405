"""Describes the compiled scenes of a run, which plan expansion samples from and workers fetch. Compiles no scene."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from schemas.scene import SceneInfo, decode_scene, read_scene_info
from schemas.storage.place import digest_of
from schemas.terms import layout_number
from schemas.view import LightFile

_KEPT_INFOS = 16


@dataclass(frozen=True)
class SceneEntry:
    """Compiled scene on disk."""

    known: SceneInfo | None
    """Metadata of the scene; `None` reads it from the package when it is needed and keeps it for a few scenes."""
    sha256: str
    """SHA-256 of the package file; workers request the package by it."""
    size: int
    """Size of the package file, bytes."""
    path: Path
    """Path of the package file."""
    light: Path | None = None
    """Path of the light groups of the scene, if the plan varies the light."""

    @property
    def info(self) -> SceneInfo:
        """Metadata of the scene.

        Raises:
            InvalidBundle: the package was damaged meanwhile.
        """
        return _read_info(self.path, self.sha256) if self.known is None else self.known

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
    """Reads digest and metadata of a package; the metadata of a layout, of which a plan has many, is not kept.

    Raises:
        InvalidBundle: the file is not a package of this format version.
    """
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
        size = file.tell()
        info = decode_scene(file).info
    return SceneEntry(info if layout_number(info.name) is None else None, sha256, size, path)


@functools.lru_cache(maxsize=_KEPT_INFOS)
def _read_info(path: Path, sha256: str) -> SceneInfo:  # noqa: ARG001 - the key of the content
    with path.open("rb") as file:
        return read_scene_info(file)
