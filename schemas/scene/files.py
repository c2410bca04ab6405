"""Reads packages and their textures from local files: the textures are in the folder `textures` beside the package."""

from __future__ import annotations

import shutil
from pathlib import Path

from schemas.errors import InvalidBundle
from schemas.scene.compiled import CompiledScene
from schemas.scene.complete import complete_package
from schemas.scene.info import SceneInfo, TextureFile
from schemas.scene.package import decode_geometry, decode_scene, read_scene_info
from schemas.scene.textures import require_texture

_REMEDY = (
    "copy the folder `textures` with the package; otherwise build the scene again with `factory scene build`, or "
    "restore a dataset's with `factory repair`"
)


def read_scene(package: Path) -> CompiledScene:
    """Reads a package of any format with the pixels of its textures.

    Raises:
        OSError: the package cannot be read.
        InvalidBundle: the package or a texture is damaged, missing or inconsistent, or has a different format version.
    """
    with package.open("rb") as file:
        return decode_scene(file, lambda texture: read_texture(package, texture))


def read_geometry(package: Path) -> CompiledScene:
    """Reads a package of any format without the pixels of its textures; raises the errors of `read_scene`."""
    with package.open("rb") as file:
        return decode_geometry(file)


def read_info(package: Path) -> SceneInfo:
    """Reads the metadata of a package of any format; raises the errors of `read_scene`."""
    with package.open("rb") as file:
        return read_scene_info(file)


def read_complete(package: Path) -> bytes:
    """Returns a package with the files of its textures; raises the errors of `read_scene`."""
    return complete_package(package.read_bytes(), lambda texture: read_texture(package, texture))


def read_texture(package: Path, texture: TextureFile) -> bytes:
    """Returns the content of the file of a texture of a package; compares its size, not its digest.

    Raises:
        InvalidBundle: the file does not exist, cannot be read or has a different size.
    """
    path = package.parent / texture.file
    try:
        if path.stat().st_size == texture.size:
            return path.read_bytes()
        problem = f"has {path.stat().st_size} bytes, expected {texture.size}"
    except FileNotFoundError:
        problem = "is missing"
    except OSError as error:
        problem = f"cannot be read ({error.strerror})"
    raise InvalidBundle(f"{package} cannot be used", [f"texture {path} {problem}; {_REMEDY}"])


def copy_package(package: Path, target: Path) -> None:
    """Copies the textures that are missing in the folder of the new path, then the package to that path."""
    for texture in read_info(package).textures:
        copy = target.parent / texture.file
        if not copy.exists():
            copy.parent.mkdir(exist_ok=True)
            shutil.copyfile(package.parent / texture.file, copy)
    shutil.copyfile(package, target)


def faulty_textures(package: Path) -> list[TextureFile]:
    """Returns the textures of a package whose files are missing or damaged; raises the errors of `read_scene`."""
    return [texture for texture in dict.fromkeys(read_info(package).textures) if not _is_sound(package, texture)]


def _is_sound(package: Path, texture: TextureFile) -> bool:
    try:
        require_texture(texture, read_texture(package, texture))
    except InvalidBundle:
        return False
    return True
