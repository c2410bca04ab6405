"""Describes the compiled scenes of a run, which plan expansion samples from and workers fetch. Compiles no scene."""

from __future__ import annotations

import functools
import hashlib
import sys
from collections.abc import Mapping, MutableMapping
from dataclasses import dataclass
from pathlib import Path

from schemas.scene import SceneInfo, decode_geometry, read_info
from schemas.scene.info import texture_file
from schemas.storage.place import digest_of
from schemas.terms import layout_number
from schemas.view import LightFile

_KEPT_INFOS = 16


@dataclass(frozen=True)
class SceneEntry:
    """Compiled scene on disk."""

    known: SceneInfo | None
    """Metadata of the scene. If it is `None`, `info` reads it from the package and caches it for a few scenes."""
    sha256: str
    """SHA-256 of the package file; workers request the package by it."""
    size: int
    """Size of the package file, bytes."""
    path: Path
    """Path of the package file."""
    textures: tuple[str, ...] = ()
    """SHA-256 of the files of its textures, which are in the folder `textures` beside the package."""
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
        if self.light is None:
            return None
        return LightFile(sha256=digest_of(self.light), size=self.light.stat().st_size)

    def texture_path(self, sha256: str) -> Path:
        return self.path.parent / texture_file(sha256)


Catalog = Mapping[str, SceneEntry]
"""Mapping of scene name to entry."""


def add_files(files: MutableMapping[str, Path], entry: SceneEntry) -> None:
    """Adds the files of a scene that workers fetch to a mapping by SHA-256: package, textures and light groups."""
    files[entry.sha256] = entry.path
    if entry.light is not None and entry.light_file is not None:
        files[entry.light_file.sha256] = entry.light
    for sha256 in entry.textures:
        if sha256 not in files:
            files[sha256] = entry.texture_path(sha256)


def read_entry(path: Path) -> SceneEntry:
    """Reads digest and metadata of a package; the metadata of a layout, of which a plan has many, is not kept.

    Does not read the files of its textures.

    Raises:
        InvalidBundle: the file is not a package of a known format version.
    """
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
        size = file.tell()
        info = decode_geometry(file).info
    # layouts share most textures; interning stores equal digests once
    textures = tuple(sys.intern(texture.sha256) for texture in info.textures)
    return SceneEntry(
        info if layout_number(info.name) is None else None, sha256, size=size, path=path, textures=textures
    )


@functools.lru_cache(maxsize=_KEPT_INFOS)
def _read_info(path: Path, sha256: str) -> SceneInfo:  # noqa: ARG001 - part of the key of the cache
    return read_info(path)
