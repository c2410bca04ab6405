"""Complete packages: a package of format 4 with the files of its textures as additional members.

A worker announces a built layout as such a file, and a rendering process receives a scene as such a file. Opens no
path.
"""

from __future__ import annotations

import io
from collections.abc import Collection, Mapping
from typing import BinaryIO, NamedTuple

from schemas.encoding.container import ContainerReader, ContainerWriter
from schemas.scene.info import TextureFile
from schemas.scene.package import PACKAGE_LIMITS, decode_geometry, read_scene_info
from schemas.scene.textures import ReadTexture, decode_texture


class PackageParts(NamedTuple):
    """Parts of a complete package."""

    package: bytes
    """The package without the files of its textures; its SHA-256 identifies the scene."""
    textures: Mapping[TextureFile, bytes]
    """Content of the files that the complete package contains."""


def complete_package(package: bytes, read: ReadTexture, known: Collection[str] = ()) -> bytes:
    """Returns a package with the files of its textures; a package that lists none is returned unchanged.

    Args:
        package: package without files of textures.
        read: function that returns the content of the file of a texture.
        known: SHA-256 of textures that the receiver has, which are omitted.

    Raises:
        InvalidBundle: the package is damaged, or `read` raises it.
    """
    reader = ContainerReader(io.BytesIO(package), PACKAGE_LIMITS)
    textures = read_scene_info(io.BytesIO(package)).textures
    if not textures:
        return package
    buffer = io.BytesIO()
    with ContainerWriter(buffer) as out:
        for name in reader.names:
            out.add(name, reader.read(name))
        for texture in dict.fromkeys(textures):
            if texture.sha256 not in known:
                out.add(texture.file, read(texture))
    return buffer.getvalue()


def split_package(file: BinaryIO) -> PackageParts:
    """Splits a complete package into the package and its textures; does not decode or verify the textures.

    Raises:
        InvalidBundle: the file is damaged.
    """
    reader = ContainerReader(file, PACKAGE_LIMITS)
    members = {texture.file: texture for texture in read_scene_info(file).textures}
    textures = {texture: reader.read(name) for name, texture in members.items() if name in reader.names}
    buffer = io.BytesIO()
    with ContainerWriter(buffer) as out:
        for name in reader.names:
            if name not in members:
                out.add(name, reader.read(name))
    return PackageParts(buffer.getvalue(), textures)


def require_sound(file: BinaryIO) -> None:
    """Decodes a package and each texture that it contains; listed textures that it does not contain are ignored.

    Raises:
        InvalidBundle: a part is damaged, inconsistent or not needed.
    """
    decode_geometry(file)
    for texture, data in split_package(file).textures.items():
        decode_texture(texture, data)
