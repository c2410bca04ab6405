"""Builds small layouts in packages of format 4, with plain textures that layouts can share."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from schemas.scene import TEXTURE_SIZE_PX, CompiledScene, TextureFile, encode_layout
from schemas.scene.complete import complete_package
from tests.builders.scene import Box, build_scene, room_walls


@dataclass(frozen=True)
class MadeLayout:
    """Package of a layout and its textures."""

    package: bytes
    textures: Mapping[TextureFile, bytes]

    @property
    def sha256(self) -> str:
        return hashlib.sha256(self.package).hexdigest()

    @property
    def names(self) -> list[str]:
        """SHA-256 of the textures."""
        return [texture.sha256 for texture in self.textures]

    def complete(self, known: Collection[str] = ()) -> bytes:
        """Returns the bundle of a build that omits known textures."""
        return complete_package(self.package, self.textures.__getitem__, known)

    def write(self, path: Path) -> Path:
        """Writes the package, and its textures beside it."""
        path.parent.mkdir(parents=True, exist_ok=True)
        for texture, data in self.textures.items():
            place = path.parent / texture.file
            place.parent.mkdir(exist_ok=True)
            place.write_bytes(data)
        path.write_bytes(self.package)
        return path


def layout_scene(layout: str, category: str = "chair", shades: tuple[int, ...] = (40, 200)) -> CompiledScene:
    """Returns a room with one object. Texture k is plain grey of value `shades[k]`; the object has the last texture."""
    textures = np.array(shades, np.uint8)[:, None, None, None] * np.ones(
        (TEXTURE_SIZE_PX, TEXTURE_SIZE_PX, 3), np.uint8
    )
    box = Box((-0.3, -0.3, 0.0), (0.3, 0.3, 0.6), category=category, texture=len(shades) - 1)
    return build_scene((*room_walls((-4.0, -3.0), (4.0, 3.0)), box), name=layout, textures=textures)


@functools.cache
def make_layout(layout: str, category: str = "chair", shades: tuple[int, ...] = (40, 200)) -> MadeLayout:
    """Returns the package of `layout_scene`."""
    made = encode_layout(layout_scene(layout, category, shades), level=1)
    return MadeLayout(made.data, made.textures)
