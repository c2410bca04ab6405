"""Draws the textures of authored scenes, or reads them from the scene cache. Does not define what they look like."""

from __future__ import annotations

import zlib
from functools import lru_cache
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from factory.scenes.author.textures import draw_texture
from factory.scenes.cached import write_whole
from factory.scenes.importer import TextureRecipe
from schemas.errors import InvalidBundle
from schemas.scene import Layer, TextureFile
from schemas.scene.textures import decode_texture, encode_texture, remember_encoded

_SEED = 0
"""Seed of all textures."""
# it does not depend on the layout, so all layouts share the files of their textures
_KEPT = 64
_FOLDER = "drawn"


def draw_pixels(recipe: TextureRecipe) -> Layer:
    """Draws a texture, which is the same for all layouts. Each texture has a separate random generator, so a new
    texture does not change others."""
    pixels = draw_texture(recipe.name, np.random.default_rng([_SEED, zlib.crc32(recipe.name.encode())]))
    pixels.flags.writeable = False
    return pixels


class DrawnTextures:
    """Textures that are read from the scene cache, or drawn and written to it.

    Args:
        cache: folder of packages; it contains the folder of the texture files.
        version: version of the authoring.
    """

    def __init__(self, cache: Path, version: str) -> None:
        self._cache, self._version = cache, version

    def pixels(self, recipe: TextureRecipe) -> Layer:
        """Returns the pixels of a texture, read-only; recently used textures are kept in memory.

        Raises:
            WorldError: the cache cannot be written.
        """
        return _pixels(self._cache, self._version, recipe)


@lru_cache(maxsize=_KEPT)
def _pixels(cache: Path, version: str, recipe: TextureRecipe) -> Layer:
    note = cache / _FOLDER / f"{recipe.name}-{version}.json"
    try:
        file = TextureFile.model_validate_json(note.read_bytes())
        data = (cache / file.file).read_bytes()
        layer = decode_texture(file, data)
    except (OSError, ValidationError, InvalidBundle):  # not drawn yet, or the file was damaged or deleted
        layer = draw_pixels(recipe)
        file, data = encode_texture(layer)
        write_whole(cache / file.file, data)
        write_whole(note, file.model_dump_json().encode())
    else:
        remember_encoded(layer, file, data)
    return layer
