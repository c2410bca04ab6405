"""Encodes and decodes the files of texture layers. Opens no path.

Decoded layers are shared between the scenes of a process for as long as one of them is used.

Design: docs/design/scenes.md#textures-are-files-beside-the-packages.
"""

from __future__ import annotations

import hashlib
import weakref
from collections.abc import Callable

import numpy as np

from schemas.encoding.ndarray import decode_npy_zst, encode_npy_zst
from schemas.errors import InvalidBundle
from schemas.scene.compiled import Layer
from schemas.scene.info import TEXTURE_SIZE_PX, TextureFile

ReadTexture = Callable[[TextureFile], bytes]
"""Function that returns the content of the file of a texture, or raises `InvalidBundle`."""

_SHAPE = (TEXTURE_SIZE_PX, TEXTURE_SIZE_PX, 3)
_RAW_BYTES = TEXTURE_SIZE_PX * TEXTURE_SIZE_PX * 3 + 4096
_LEVEL = 5
"""Compression level. Level 9 would give files that are 3 % smaller, in twice the time."""
_KEPT_FILES = 256
_decoded: weakref.WeakValueDictionary[str, Layer] = weakref.WeakValueDictionary()
"""Layers that are in use, by the SHA-256 of their file."""
_encoded: dict[bytes, tuple[TextureFile, bytes]] = {}
"""Files of recently encoded layers by the SHA-256 of the pixels, the most recent one last."""


def encode_texture(layer: Layer) -> tuple[TextureFile, bytes]:
    """Returns the file of a layer (512, 512, 3) and its content; equal layers give equal bytes.

    The files of recently encoded layers are kept, because layouts share them.
    """
    encoded = _encoded.get(_digest(layer))
    if encoded is None:
        data = encode_npy_zst(layer, level=_LEVEL)
        encoded = TextureFile(sha256=hashlib.sha256(data).hexdigest(), size=len(data)), data
    remember_encoded(layer, *encoded)
    return encoded


def remember_encoded(layer: Layer, texture: TextureFile, data: bytes) -> None:
    """Keeps the file of a layer, so the layer is not compressed again."""
    key = _digest(layer)
    _encoded.pop(key, None)
    _encoded[key] = texture, data
    while len(_encoded) > _KEPT_FILES:
        del _encoded[next(iter(_encoded))]


def _digest(layer: Layer) -> bytes:
    return hashlib.sha256(np.ascontiguousarray(layer).data).digest()


def require_texture(texture: TextureFile, data: bytes) -> None:
    """Checks the size and the digest of the file of a texture.

    Raises:
        InvalidBundle: the file has a different size or digest.
    """
    sha256 = hashlib.sha256(data).hexdigest()
    if (len(data), sha256) != (texture.size, texture.sha256):
        raise InvalidBundle(
            "texture refused",
            [f"{texture.file}: {len(data)} bytes with SHA-256 {sha256[:16]}, expected {texture.size} bytes"],
        )


def decode_texture(texture: TextureFile, data: bytes) -> Layer:
    """Decodes the file of a texture.

    Raises:
        InvalidBundle: the file has a different size or digest, or is not a layer.
    """
    require_texture(texture, data)
    return decode_npy_zst(texture.file, data, dtype=np.uint8, shape=_SHAPE, max_bytes=_RAW_BYTES).astype(
        np.uint8, copy=False
    )


def load_texture(texture: TextureFile, read: ReadTexture) -> Layer:
    """Returns a layer, which must not be changed; reads and decodes it unless a scene of this process uses it."""
    layer = _decoded.get(texture.sha256)
    if layer is None:
        layer = _decoded[texture.sha256] = decode_texture(texture, read(texture))
    return layer
