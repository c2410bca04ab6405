"""Palettes of homes, shops and schools: floors, wall paints, wallpapers, ceilings, window views, furniture looks.

Draws a style from a random generator. Does not build anything.
"""

from __future__ import annotations

from typing import NamedTuple

from numpy.random import Generator

from factory.scenes.author.materials import SurfaceMaterial, painted, tinted, wood
from factory.scenes.author.room import Trim

_BOARD_TINTS = {"Honey": "#c4925a", "Nut": "#8a6040", "Sand": "#d8bd94", "Grey": "#a39c92", "Smoke": "#6d5e52"}
_PILE_TINTS = {"Oat": "#c9bca4", "Slate": "#7f8892", "Moss": "#7f8a6c", "Plum": "#83707f", "Ink": "#5a6780"}
_STONE_TINTS = {"Chalk": "#dcd8ce", "Clay": "#b9805c", "Graphite": "#75787c", "Fog": "#b7bcbf", "Sage": "#a9b5a2"}
_PAINT_TINTS = {
    "Chalk": "#e4e0d6", "Linen": "#dccfb4", "Sky": "#a9c1cf", "Sage": "#a8b79b", "Rose": "#d3aea0", "Butter": "#e2cf98",
    "Lilac": "#b9aec6", "Ocean": "#6f93a6", "Olive": "#8d9372", "Terracotta": "#bd8468",
    "Stone": "#b9b4aa", "Mint": "#b2cdbf",
}  # fmt: skip
CEILINGS = ("plain", "plain", "beams", "boards", "panels")
RUGS = ("RugRed", "RugBlue", "RugCream", "RugGreen", "RugGrey")

_WALLPAPERS = ("Plaster", "Plaster", "Plaster", "WallpaperStripes", "WallpaperDamask")
PLAIN_WALLS = ("Plaster", "Plaster", "Plaster", "Bricks")
"""Textures of the walls of a shop or a school."""


class Palette(NamedTuple):
    """Style of one building."""

    boards: SurfaceMaterial
    stone: SurfaceMaterial
    pile: SurfaceMaterial
    paints: tuple[SurfaceMaterial, ...]
    """Wall paints and wallpapers in random order."""
    tiles: SurfaceMaterial
    """Wall tiles of wet rooms."""
    trim: Trim
    leaf: SurfaceMaterial
    ceiling: str
    view: int
    """Variant of the windows."""
    curtain: int
    wood: int
    """Variant of the wooden furniture."""
    cover: int
    """Variant of the upholstery."""
    rug: str


def draw_palette(rng: Generator, walls: tuple[str, ...] = _WALLPAPERS) -> Palette:
    """Draws a style: each part of it independently of the others; `walls` are the textures of the walls."""
    plank = ("Boards", "Boards", "Herringbone")[int(rng.integers(3))]
    stone = ("SquareTiles", "ChequerTiles", "Terrazzo", "SmallTiles")[int(rng.integers(4))]
    names = list(_PAINT_TINTS)
    paints = [_paint(rng, walls, names[k]) for k in rng.permutation(len(names))[:6]]
    return Palette(
        boards=_pick(rng, plank, "Floor", _BOARD_TINTS, 1.6, 0.5),
        stone=_pick(rng, stone, "Stone", _STONE_TINTS, 1.4, 0.35),
        pile=_pick(rng, "Pile", "Pile", _PILE_TINTS, 1.5, 0.95),
        paints=tuple(paints),
        tiles=_pick(rng, "SmallTiles", "WallTile", {**_STONE_TINTS, "Aqua": "#9fc2c4"}, 1.0, 0.3),
        trim=Trim(skirting=(painted("White", 0.45), wood("Walnut"), wood("Oak"))[int(rng.integers(3))]),
        leaf=(painted("White", 0.45), wood("Oak"), wood("Walnut"), painted("LightGrey", 0.5))[int(rng.integers(4))],
        ceiling=CEILINGS[int(rng.integers(len(CEILINGS)))],
        view=int(rng.integers(12)),
        curtain=int(rng.integers(6)),
        wood=int(rng.integers(12)),
        cover=int(rng.integers(12)),
        rug=RUGS[int(rng.integers(len(RUGS)))],
    )


def _pick(
    rng: Generator, texture: str, prefix: str, tints: dict[str, str], tile_m: float, roughness: float
) -> SurfaceMaterial:
    name = list(tints)[int(rng.integers(len(tints)))]
    return tinted(texture, f"{prefix}{texture}{name}", tints[name], tile_m, roughness)


def _paint(rng: Generator, walls: tuple[str, ...], name: str) -> SurfaceMaterial:
    """Returns a wall in a colour, with one of the textures."""
    texture = walls[int(rng.integers(len(walls)))]
    return tinted(texture, f"Wall{texture}{name}", _PAINT_TINTS[name], 0.8 if texture != "Bricks" else 1.2, 0.9)
