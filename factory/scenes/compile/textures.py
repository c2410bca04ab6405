"""Decodes the textures of a scene into one array of unique 512 x 512 sRGB layers.

Uses Pillow. A missing or surplus texture is replaced by a plain colour, with a note.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from factory.scenes.importer import Cutout, Surface, TextureRecipe
from schemas.appearance.colour_names import linear_of
from schemas.scene import DRAWN, TEXTURE_SIZE_PX, Layer

MAX_LAYERS = 64
_MAX_SOURCE_PX = 16384
_BROKEN = (OSError, ValueError, SyntaxError, Image.DecompressionBombError, Image.DecompressionBombWarning)
_PALETTES = ("P", "PA", "LA", "RGBA")


DrawFunction = Callable[[TextureRecipe], Layer]
"""Function that returns the pixels (512, 512, 3) of a texture."""


@dataclass(frozen=True)
class TextureBook:
    """Texture layers of a scene, with the layer of each texture path."""

    layers: tuple[Layer, ...]
    """Layers, each (512, 512, 3), sRGB, top row first."""
    layer_of: Mapping[str, int]
    """Texture path -> layer index."""
    mean_of: Mapping[str, tuple[float, float, float]]
    """Texture path -> linear mean colour, for every readable texture."""
    notes: tuple[str, ...]
    masks: Mapping[int, NDArray[np.uint8]] = field(default_factory=dict)
    """Masks (512, 512) of the layers that cut holes; see `CompiledScene.masks`."""


def load_textures(
    areas: Mapping[str, float],
    read: Callable[[str], bytes | TextureRecipe | None],
    users: Mapping[str, str] = MappingProxyType({}),
    draw: DrawFunction | None = None,
    cutouts: Mapping[str, Surface] = MappingProxyType({}),
) -> TextureBook:
    """Decodes the textures of a scene.

    Args:
        areas: area that each texture path covers, square metres; the textures with the largest areas get a layer.
        read: function that returns the bytes of a path, a texture to draw, or `None`.
        users: for each texture path, a prim that uses it, for the notes.
        draw: function that returns the pixels of a texture to draw; not needed for a scene from a file.
        cutouts: surfaces whose texture cuts holes, by their key in `areas` (`Surface.picture`); the other keys are
            paths.
    """
    notes: list[str] = []
    pictures: dict[str, Layer] = {}
    masks: dict[str, NDArray[np.uint8]] = {}
    digest_of: dict[str, str] = {}
    for path in sorted(areas):
        surface, user = cutouts.get(path), users.get(path, "")
        name = path if surface is None else surface.texture
        data = read(name)
        digest = hashlib.sha256(repr(data).encode() if isinstance(data, TextureRecipe) else data or b"").hexdigest()
        cutout = None if surface is None else surface.cutout
        mask = None if cutout is None else _read_mask(cutout, read, user, notes)
        is_plain = cutout is not None and cutout.is_plain
        if mask is not None:
            digest = hashlib.sha256(f"{digest} {is_plain} ".encode() + mask.tobytes()).hexdigest()
        if digest in pictures:
            picture: Layer | None = pictures[digest]
        elif isinstance(data, TextureRecipe):
            picture = _drawn(data, draw)
        elif mask is None:
            picture = _decode(name, data, user, notes)
        else:
            picture = _WHITE if is_plain else _decode(name, data, user, notes)
            picture = None if picture is None else _without_fringes(picture, mask)
        if picture is not None:
            pictures[digest], digest_of[path] = picture, digest
            masks |= {} if mask is None else {digest: mask}
    kept = _largest(areas, digest_of, notes)
    return TextureBook(
        layers=tuple(pictures[digest] for digest in kept),
        layer_of={path: kept.index(digest) for path, digest in digest_of.items() if digest in kept},
        mean_of={path: _mean(pictures[digest], masks.get(digest)) for path, digest in digest_of.items()},
        notes=tuple(notes),
        masks={layer: masks[digest] for layer, digest in enumerate(kept) if digest in masks},
    )


_WHITE: Layer = np.full((TEXTURE_SIZE_PX, TEXTURE_SIZE_PX, 3), 255, np.uint8)


def _read_mask(
    cutout: Cutout, read: Callable[[str], bytes | TextureRecipe | None], user: str, notes: list[str]
) -> NDArray[np.uint8] | None:
    """Returns the mask (512, 512) of a texture; `None` if nothing is cut out, with a note if it cannot be read."""
    data, name = read(cutout.image), f"{user}: opacity texture {cutout.image.rpartition('/')[2]}"
    if not isinstance(data, bytes):
        notes.append(f"{name} is missing, drawn solid; put it where the material looks for it")
        return None
    try:
        mask = _mask(data, cutout)
    except _BROKEN as error:
        notes.append(f"{name} cannot be read ({error}), drawn solid; save it again as 8-bit PNG")
        return None
    return None if (mask >= DRAWN).all() and not cutout.is_plain else mask


def _without_fringes(picture: Layer, mask: NDArray[np.uint8]) -> Layer:
    """Returns a picture with the mean colour in its holes, whose colours the renderer blends into their edges."""
    holes = mask < DRAWN
    if holes.all():
        return picture
    whole = picture.copy()
    whole[holes] = np.rint(picture[~holes].mean(axis=0)).astype(np.uint8)
    return whole


def _mask(data: bytes, cutout: Cutout) -> NDArray[np.uint8]:
    """Returns the mask (512, 512) of an image: its opacity, shifted so `DRAWN` is the threshold."""
    with Image.open(io.BytesIO(data)) as file:
        _require_size(file)
        has_palette = file.mode in _PALETTES or "transparency" in file.info
        image = file.convert("RGBA") if has_palette else file.copy()
        if cutout.channel == "a" and "A" not in image.getbands():
            # a texture without alpha is opaque; one that has only the opacity is gray
            opacity = _eight_bit(image).getchannel("R") if cutout.is_plain else Image.new("L", image.size, 255)
        else:
            channel = cutout.channel.upper()
            opacity = image.getchannel("A") if channel == "A" else _eight_bit(image).getchannel(channel)
        opacity = opacity.resize((TEXTURE_SIZE_PX, TEXTURE_SIZE_PX), Image.Resampling.BILINEAR)
    values = np.array(opacity, np.int64)
    return np.clip(values - int(np.ceil(cutout.threshold * 255)) + DRAWN, 0, 255).astype(np.uint8)


def _drawn(recipe: TextureRecipe, draw: DrawFunction | None) -> Layer:
    if draw is None:
        raise ValueError(f"texture {recipe.name} is to be drawn, but no function for it was given")
    return draw(recipe)


def _decode(path: str, data: bytes | None, user: str, notes: list[str]) -> Layer | None:
    name = f"{user}: texture {path.rpartition('/')[2]}".removeprefix(": ")
    if data is None:
        notes.append(f"{name} is missing, shown in one colour; put it where the material looks for it")
        return None
    try:
        return _read(data)
    except _BROKEN as error:
        notes.append(f"{name} cannot be read ({error}), shown in one colour; save it again as 8-bit PNG or JPEG")
        return None


@lru_cache(maxsize=MAX_LAYERS)
def _read(data: bytes) -> Layer:
    """Returns the pixels of an image, read-only. They are cached, because the layouts built in a process share
    textures."""
    with Image.open(io.BytesIO(data)) as image:
        _require_size(image)
        plain, size = _eight_bit(image), (TEXTURE_SIZE_PX, TEXTURE_SIZE_PX)
        pixels = np.array(plain if plain.size == size else plain.resize(size, Image.Resampling.LANCZOS))
    pixels.flags.writeable = False
    return pixels


def _require_size(image: Image.Image) -> None:
    if max(image.size) > _MAX_SOURCE_PX:
        raise ValueError(f"{image.size[0]} x {image.size[1]} pixels")


def _eight_bit(image: Image.Image) -> Image.Image:
    """Converts an image to 8-bit RGB; scales 16-bit gray, which the conversion of Pillow would clip."""
    if image.mode.startswith(("I", "F")):
        values = np.asarray(image, np.float64)
        top = 255.0 / max(float(values.max()), 1e-9) if image.mode == "F" else 1 / 257
        return Image.fromarray(np.clip(values * top, 0, 255).astype(np.uint8)).convert("RGB")
    if image.mode in _PALETTES:
        image = image.convert("RGBA")
    return image.convert("RGB")


def _largest(areas: Mapping[str, float], digest_of: Mapping[str, str], notes: list[str]) -> list[str]:
    """Returns the digests of the textures that get a layer, which cover the largest areas, in a stable order."""
    covered: dict[str, float] = {}
    for path, digest in digest_of.items():
        covered[digest] = covered.get(digest, 0.0) + areas[path]
    if len(covered) > MAX_LAYERS:
        notes.append(f"{len(covered)} textures, {MAX_LAYERS} kept by area; the others are shown in their mean colour")
    by_area = sorted(covered, key=lambda digest: (-covered[digest], digest))[:MAX_LAYERS]
    return sorted(by_area)


def _mean(picture: Layer, mask: NDArray[np.uint8] | None = None) -> tuple[float, float, float]:
    pixels, drawn = picture[::4, ::4].reshape(-1, 3), None if mask is None else mask[::4, ::4].ravel() >= DRAWN
    if drawn is not None and drawn.any():
        pixels = pixels[drawn]
    small = linear_of(pixels / 255).mean(axis=0)
    return (float(small[0]), float(small[1]), float(small[2]))
