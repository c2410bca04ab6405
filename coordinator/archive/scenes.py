"""Base class of archives: stores compiled scenes and the textures that they share. Independent of the storage.

The textures of a scene are stored before its package, so an interruption leaves at most textures that no package
needs; `sweep_textures` deletes them. The module does not decode scenes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from pathlib import Path

import structlog

from schemas.errors import ArchiveCorrupt
from schemas.scene.info import TEXTURES, texture_file
from schemas.storage.dataset_files import SCENES
from schemas.storage.place import Place, children, digest_of

log = structlog.get_logger(__name__)


def scene_file(name: str, sha256: str) -> str:
    """Returns the file name of a compiled scene in the scene folder."""
    return f"{name}-{sha256[:16]}.scene.zip"


class SceneStore(ABC):
    """Scenes and textures of a dataset; see `Archive`."""

    root: Place

    @abstractmethod
    def _keep(self, source: Path, place: Place) -> None:
        """Stores a copy of a file durably under a new name."""

    @abstractmethod
    def _drop(self, place: Place) -> None:
        """Deletes a file."""

    def add_scene(self, source: Path, name: str, sha256: str, textures: Sequence[str] = ()) -> Place:
        place = self.scene_path(name, sha256)
        if not place.exists():
            _require_digest(source, sha256)
            for texture in textures:
                self.add_texture(source.parent / texture_file(texture), texture)
            self._keep(source, place)
        return place

    def add_texture(self, source: Path, sha256: str) -> Place:
        place = self.texture_path(sha256)
        if not place.exists():
            _require_digest(source, sha256)
            self._keep(source, place)
        return place

    def scene_path(self, name: str, sha256: str) -> Place:
        return self.root / SCENES / scene_file(name, sha256)

    def texture_path(self, sha256: str) -> Place:
        return self.root / SCENES / texture_file(sha256)

    def sweep_textures(self, needed: Collection[str]) -> None:
        places = set(map(self.texture_path, needed))
        for place in children(self.root / SCENES / TEXTURES):
            if place not in places:
                log.info("texture_removed", texture=place.name, why="no scene of the run needs it")
                self._drop(place)


def _require_digest(source: Path, sha256: str) -> None:
    try:
        digest = digest_of(source)
    except FileNotFoundError as error:
        raise ArchiveCorrupt(f"{source} is missing, expected SHA-256 {sha256}: build the scene again") from error
    if digest != sha256:
        raise ArchiveCorrupt(f"{source} has SHA-256 {digest}, expected {sha256}: build the scene again")
