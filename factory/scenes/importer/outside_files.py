"""Keeps an import inside the folder of its stage: what a material names elsewhere on the disk is not read.

Compares paths, links followed; reads nothing.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

from factory.scenes.importer.material import Surface

__all__ = ["Fence"]


@dataclass(frozen=True)
class Fence:
    """The folder of the root layer."""

    root_layer: Path
    is_open: bool
    """Whether everything may be read."""

    def encloses(self, asset: str) -> bool:
        """Whether an absolute asset path, `a.usdz[b.png]` included, lies in the folder tree."""
        file = Path(asset.partition("[")[0])
        return self.is_open or file.resolve().is_relative_to(self.root_layer.resolve().parent)

    def kept_inside(self, surface: Surface, material: str, notes: list[str]) -> Surface:
        """Returns the surface, in its plain colour when its texture lies outside.

        Args:
            surface: as the material has it.
            material: path of the material's prim.
            notes: receives what was refused.
        """
        texture = surface.texture
        climbs = ".." in Path(texture).parts and not Path(texture).is_absolute()  # unresolved: not there, or no right
        if not texture or (not climbs and (not Path(texture).is_absolute() or self.encloses(texture))):
            return surface
        shown = os.path.relpath(texture, self.root_layer.resolve().parent) if not climbs else texture
        notes.append(
            f"{material}: texture {shown} lies outside of the stage's folder, shown in one colour; "
            "move it below the folder or allow it (--allow-outside, in a plan allow_outside = true)"
        )
        return replace(surface, texture="", colour=surface.fallback)
