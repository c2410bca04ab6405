"""Surface materials of the built-in scenes: plain colour or tiled texture, roughness, metallic and emission.

Colours are sRGB hex strings. Does not draw textures and does not write USD.
"""

from __future__ import annotations

from dataclasses import dataclass

from factory.scenes.author.geometry import AuthoredMesh


@dataclass(frozen=True)
class SurfaceMaterial:
    """Appearance of a surface.

    Attributes:
        name: name that is unique within a scene; the prim is `M_<name>`.
        colour: sRGB "#rrggbb"; for textured materials, the colour in viewers that show no textures.
        texture: name of a texture recipe, or None for plain colour.
        tile_m: length of one repeat of the texture, metres.
        roughness: roughness, 0..1.
        metallic: 0 or 1.
        glow: emitted share of the colour; 0 for surfaces without emission.
        tint: sRGB "#rrggbb" factor of the texture, or None.
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
    """Mesh with its material."""

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
    "Pink": "#d9849c",
    "Cream": "#efe8d8",
}
"""Paint name -> sRGB colour."""


_WOODS = {
    "Oak": "#cb9f66",
    "Walnut": "#7c5233",
    "Pale": "#e2c79c",
    "Cherry": "#9a5636",
    "Ebony": "#43352c",
    "Ash": "#b8a68c",
}


def painted(paint: str, roughness: float = 0.6, metallic: float = 0.0) -> SurfaceMaterial:
    """Returns the plain material of a named paint."""
    finish = "" if (roughness, metallic) == (0.6, 0.0) else f"_r{round(roughness * 100)}m{round(metallic)}"
    return SurfaceMaterial(paint + finish, PAINTS[paint], roughness=roughness, metallic=metallic)


def textured(texture: str, colour: str, tile_m: float, roughness: float = 0.7) -> SurfaceMaterial:
    """Returns a material that repeats a texture every `tile_m` metres."""
    return SurfaceMaterial(texture, colour, texture=texture, tile_m=tile_m, roughness=roughness)


def tinted(texture: str, name: str, colour: str, tile_m: float = 1.0, roughness: float = 0.7) -> SurfaceMaterial:
    """Returns a material that multiplies a light texture with a colour, so paints share one texture."""
    return SurfaceMaterial(name, colour, texture=texture, tile_m=tile_m, roughness=roughness, tint=colour)


def wood(name: str) -> SurfaceMaterial:
    """Returns furniture wood: Oak, Walnut, Pale, Cherry, Ebony or Ash, all tints of one texture."""
    return tinted("Grain", f"Wood{name}Tint", colour=_WOODS[name], tile_m=0.9, roughness=0.5)


def cloth(paint: str) -> SurfaceMaterial:
    """Returns upholstery in the colour of a named paint; all tints of one texture."""
    return tinted("Cloth", f"Cloth{paint}", colour=PAINTS[paint], tile_m=0.4, roughness=0.95)


def glowing(name: str, colour: str, texture: str | None = None, glow: float = 1.0) -> SurfaceMaterial:
    """Returns an emissive material, for lamp panels, screens and daylight windows."""
    return SurfaceMaterial(name, colour, texture, glow=glow)


def linear_rgb(colour: str) -> tuple[float, float, float]:
    """Converts sRGB "#rrggbb" to linear RGB in [0, 1] (IEC 61966-2-1), as UsdPreviewSurface requires."""
    channels = [int(colour[start : start + 2], 16) / 255 for start in (1, 3, 5)]
    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels)
    return red, green, blue
