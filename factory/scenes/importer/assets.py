"""Reads the bytes of USD assets, inside a .usdz package or in the folder of the stage. Does not decode them."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pxr import Ar, Sdf

from factory.scenes.importer.content import Surface


def asset_path(value: Any) -> str:
    """Returns the resolved path of an asset value, or the authored path if USD cannot resolve it."""
    return str(value.resolvedPath or value.path) if isinstance(value, Sdf.AssetPath) else str(value)


def read_asset(path: str) -> bytes | None:
    """Returns the bytes of a resolved asset, or `None` if it cannot be read."""
    if not Path(path).is_absolute():  # unresolved; USD would open it relative to the working directory
        return None
    asset = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(path))
    if asset is None:
        return None
    with asset:
        return bytes(asset.GetBuffer())


def sibling(layer_path: str, name: str) -> str:
    """Returns the path of a file relative to a layer, also inside packages such as `a.usdz[b.usda]`."""
    head, bracket, inner = layer_path.rpartition("[")
    if bracket:
        return f"{head}[{(Path(inner.rstrip(']')).parent / name).as_posix()}]"
    return str(Path(layer_path).parent / name)


@dataclass(frozen=True)
class ReadableFolder:
    """Folder of the root layer, from which an import may read textures.

    A stage of another author could name any file of the user as a texture.
    """

    root_layer: Path
    is_open: bool
    """Whether all paths are allowed."""
    also: tuple[Path, ...] = ()
    """Additional folders from which files may be read."""

    def encloses(self, asset: str) -> bool:
        """Returns whether an absolute asset path, such as `a.usdz[b.png]`, is inside the folder."""
        file = Path(asset.partition("[")[0])
        folders = (self.root_layer.resolve().parent, *(folder.resolve() for folder in self.also))
        return self.is_open or any(file.resolve().is_relative_to(folder) for folder in folders)

    def kept_inside(self, surface: Surface, material: str, notes: list[str]) -> Surface:
        """Returns the surface, with a plain colour if its texture is outside the folder.

        Args:
            surface: appearance of the material.
            material: path of the material prim.
            notes: list that receives a note for each rejected texture.
        """
        texture = next((image for image in sorted(surface.images) if self._is_outside(image)), None)
        if texture is None:
            return surface
        shown = os.path.relpath(texture, self.root_layer.resolve().parent) if not _climbs(texture) else texture
        notes.append(
            f"{material}: texture {shown} is outside of the stage's folder, shown in one colour; "
            "move it below the folder or allow it (--allow-outside, in a plan allow_outside = true)"
        )
        return replace(surface, texture="", cutout=None, colour=surface.fallback)

    def _is_outside(self, texture: str) -> bool:
        return _climbs(texture) or (Path(texture).is_absolute() and not self.encloses(texture))


def _climbs(texture: str) -> bool:
    return ".." in Path(texture).parts and not Path(texture).is_absolute()  # a resolved path is absolute
