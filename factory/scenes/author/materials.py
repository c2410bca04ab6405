"""Surface materials of the authored scenes: a plain colour or a tiled texture, plus how rough and bright it is.

Holds colours as sRGB hex, as a designer reads them; never generates pixels and never touches USD.
"""

from __future__ import annotations

from dataclasses import dataclass

from factory.scenes.author.geometry import AuthoredMesh

__all__ = ["PAINTS", "PropPiece", "SurfaceMaterial", "glowing", "linear_rgb", "painted", "textured", "tinted"]


@dataclass(frozen=True)
class SurfaceMaterial:
    """What a surface looks like.

    Attributes:
        name: unique within a scene; becomes the prim name `M_<name>`.
        colour: sRGB "#rrggbb"; for textured materials only a hint for viewers without textures.
        texture: name of a texture recipe, or None for plain colour.
        tile_m: metres covered by one repeat of the texture.
        roughness: 0 mirror to 1 chalk.
        metallic: 0 or 1.
        glow: emitted share of the colour, 0 for ordinary surfaces.
        tint: sRGB "#rrggbb" that multiplies the texture, or None.
    """

    name: str
    colour: str
    texture: str | None = None
    tile_m: float = 1.0
    roughness: float = 0.6
    metallic: float = 0.0
    glow: float = 0.0
    tint: str | None = None


@dataclass(frozen=True)
class PropPiece:
    """A mesh with its material."""

    material: SurfaceMaterial
    mesh: AuthoredMesh


PAINTS = {
    "Black": "#1c1c1f",
    "Charcoal": "#3a3c40",
    "Grey": "#85888c",
    "LightGrey": "#bdc0c2",
    "White": "#eeeeea",
    "Red": "#b5201c",
    "DarkRed": "#7d1a1a",
    "Orange": "#e0701a",
    "Yellow": "#e8b81c",
    "Green": "#2c8a3c",
    "Teal": "#1f7f82",
    "Blue": "#1d4fa8",
    "SkyBlue": "#5b9bd5",
    "Navy": "#1c2b52",
    "Purple": "#6a3d8f",
    "Brown": "#6b4226",
    "Beige": "#cdb892",
    "Terracotta": "#a9542f",
    "Leaf": "#3a7d2c",
    "DarkLeaf": "#23592a",
    "Soil": "#3b2a1e",
    "Steel": "#a5abb0",
    "Chrome": "#c9ced2",
    "Rubber": "#2a2a2c",
}
"""Plain paints by name, sRGB."""


def painted(paint: str, roughness: float = 0.6, metallic: float = 0.0) -> SurfaceMaterial:
    """The plain material of a named paint."""
    shine = "" if (roughness, metallic) == (0.6, 0.0) else f"_r{round(roughness * 100)}m{round(metallic)}"
    return SurfaceMaterial(paint + shine, PAINTS[paint], roughness=roughness, metallic=metallic)


def textured(texture: str, colour: str, tile_m: float, roughness: float = 0.7) -> SurfaceMaterial:
    """A material that repeats a texture every `tile_m` metres."""
    return SurfaceMaterial(texture, colour, texture, tile_m, roughness)


def tinted(texture: str, name: str, colour: str, tile_m: float = 1.0, roughness: float = 0.7) -> SurfaceMaterial:
    """A material that multiplies a light texture with a colour, so that many paints share one picture."""
    return SurfaceMaterial(name, colour, texture, tile_m, roughness, tint=colour)


def glowing(name: str, colour: str, texture: str | None = None, glow: float = 1.0) -> SurfaceMaterial:
    """A surface that shines by itself: lamp panels, lit screens, daylight windows."""
    return SurfaceMaterial(name, colour, texture, glow=glow)


def linear_rgb(colour: str) -> tuple[float, float, float]:
    """Converts sRGB "#rrggbb" to linear RGB in [0, 1] (IEC 61966-2-1), as UsdPreviewSurface wants it."""
    channels = [int(colour[start : start + 2], 16) / 255 for start in (1, 3, 5)]
    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels)
    return red, green, blue
