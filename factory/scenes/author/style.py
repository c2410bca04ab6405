"""Palettes of buildings: floors, walls, dados, doors, ceilings, window views, rugs, furniture looks.

Draws a style from a random generator. Does not build anything.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

from numpy.random import Generator

from factory.scenes.author.materials import SurfaceMaterial, painted, tinted, wood
from factory.scenes.author.props.wall import OUTLOOKS
from factory.scenes.author.room import Trim
from factory.scenes.author.textures.rugs import RUGS

Choice = TypeVar("Choice")

_BOARD_TINTS = {"Honey": "#c4925a", "Nut": "#8a6040", "Sand": "#d8bd94", "Grey": "#a39c92", "Smoke": "#6d5e52",
                "Cherry": "#9c5a3c", "White": "#cfc6b8"}  # fmt: skip
_PILE_TINTS = {"Oat": "#c9bca4", "Slate": "#7f8892", "Moss": "#7f8a6c", "Plum": "#83707f", "Ink": "#5a6780",
               "Rust": "#a5684c", "Teal": "#5f8686", "Mocha": "#7a675a"}  # fmt: skip
_STONE_TINTS = {"Chalk": "#dcd8ce", "Clay": "#b9805c", "Graphite": "#75787c", "Fog": "#b7bcbf", "Sage": "#a9b5a2",
                "Sand": "#cdb98f", "Night": "#4b5666", "Rose": "#c9a59a"}  # fmt: skip
_PAINT_TINTS = {
    "Chalk": "#e4e0d6", "Linen": "#dccfb4", "Sky": "#a9c1cf", "Sage": "#a8b79b", "Rose": "#d3aea0", "Butter": "#e2cf98",
    "Lilac": "#b9aec6", "Ocean": "#6f93a6", "Olive": "#8d9372", "Terracotta": "#bd8468",
    "Stone": "#b9b4aa", "Mint": "#b2cdbf", "Peach": "#e6bd9c", "Mustard": "#c9a24e", "Denim": "#5f7896",
    "Brick": "#a2604c", "Plum": "#8d6c86", "Forest": "#5f7a63", "Ash": "#cfcfcb", "Cocoa": "#8f7766",
}  # fmt: skip
CEILINGS = ("plain", "plain", "beams", "boards", "panels")
_PLANKS = ("Boards", "Boards", "Herringbone", "BasketParquet", "WideBoards")
_STONES = ("SquareTiles", "ChequerTiles", "Terrazzo", "SmallTiles", "Hexagons", "Marble")
_PILES = ("Pile", "LoopPile")
_WET_WALLS = ("SmallTiles", "SubwayTiles", "Hexagons")
_WALLPAPERS = (
    "Plaster", "Plaster", "Plaster", "WallpaperStripes", "WallpaperDamask", "WallpaperTrellis", "WallpaperDots",
    "WallpaperLeaves",
)  # fmt: skip
_PLAIN_WALLS = ("Plaster", "Plaster", "Plaster", "Bricks", "BlockWork", "Panelling")
_WALL_TILE_M = {"Bricks": 1.2, "BlockWork": 1.6, "Panelling": 1.0, "Sheeting": 2.0}
"""Length of one repeat of a wall texture, metres; 0.8 m for textures that are not listed."""


_SURROUNDINGS = (
    ("ViewStreet", "WindowView", "ViewTowers", "ViewPark"),
    ("ViewSuburb", "ViewGarden", "ViewVillage", "ViewHills", "ViewWoods"),
    ("ViewSea", "ViewHarbour"),
    ("ViewSnow",),
    ("ViewDesert",),
)
"""Groups of views that suit each other. The windows of a building show views of one group."""


class Finishes(NamedTuple):
    """Textures from which the palette of a kind of building is chosen."""

    walls: tuple[str, ...]
    stones: tuple[str, ...] = _STONES
    piles: tuple[str, ...] = _PILES
    paints: tuple[str, ...] = tuple(_PAINT_TINTS)
    """Names of the tints of the walls."""
    stone_tints: tuple[str, ...] = tuple(_STONE_TINTS)


HOME = Finishes(_WALLPAPERS)
PUBLIC = Finishes(_PLAIN_WALLS)
"""Finishes of shops and schools."""
OFFICE = Finishes(
    ("Plaster", "Plaster", "Plaster", "Plaster", "Bricks", "Panelling", "WallpaperStripes", "WallpaperTrellis"),
    ("SquareTiles", "Terrazzo", "Screed", "Hexagons", "Marble"),
    ("CarpetTiles", "CarpetTiles", "Pile", "LoopPile"),
)
CLINIC = Finishes(
    ("Plaster",),
    ("Vinyl", "Terrazzo", "SquareTiles", "Marble"),
    ("Vinyl", "Vinyl", "WideBoards"),
    ("Chalk", "Linen", "Sky", "Sage", "Rose", "Butter", "Lilac", "Ocean", "Stone", "Mint", "Peach", "Ash"),
)
HALL = Finishes(
    ("Sheeting", "Sheeting", "BlockWork", "Plaster", "Bricks"),
    ("Screed",),
    piles=("CarpetTiles", "LoopPile"),
    paints=("Chalk", "Linen", "Sky", "Sage", "Butter", "Ocean", "Stone", "Mint", "Denim", "Ash", "Olive"),
    stone_tints=("Chalk", "Graphite", "Fog", "Sage", "Sand", "Fog"),
)
"""Finishes of warehouses."""


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
    views: tuple[int, int]
    """Variant of the windows to the south and west, and variant of the windows to the north and east."""
    curtain: int
    wood: int
    """Variant of the wooden furniture."""
    cover: int
    """Variant of the upholstery."""
    rugs: tuple[str, ...]
    """Textures of the rugs."""
    art: int
    """Number of the first variant of pictures and tapestries; the building uses this variant and the next few."""


def draw_palette(rng: Generator, finishes: Finishes = HOME) -> Palette:
    """Chooses a style at random, each part independently of the others."""
    names, stones = finishes.paints, {name: _STONE_TINTS[name] for name in finishes.stone_tints}
    paints = [_paint(rng, finishes.walls, names[k]) for k in rng.permutation(len(names))[:6]]
    frame = int(rng.integers(2)) * len(OUTLOOKS)
    return Palette(
        boards=_pick(rng, _one(rng, _PLANKS), prefix="Floor", tints=_BOARD_TINTS, tile_m=1.6, roughness=0.5),
        stone=_pick(rng, _one(rng, finishes.stones), prefix="Stone", tints=stones, tile_m=1.4, roughness=0.35),
        pile=_pick(rng, _one(rng, finishes.piles), prefix="Pile", tints=_PILE_TINTS, tile_m=1.5, roughness=0.95),
        paints=tuple(paints),
        tiles=_pick(
            rng,
            _one(rng, _WET_WALLS),
            prefix="WallTile",
            tints={**_STONE_TINTS, "Aqua": "#9fc2c4"},
            tile_m=1.0,
            roughness=0.3,
        ),
        trim=_trim(rng),
        leaf=_one(rng, (painted("White", 0.45), wood("Oak"), wood("Walnut"), painted("LightGrey", 0.5))),
        ceiling=_one(rng, CEILINGS),
        views=_views(rng, frame),
        curtain=int(rng.integers(6)),
        wood=int(rng.integers(12)),
        cover=int(rng.integers(12)),
        rugs=tuple(list(RUGS)[k] for k in rng.permutation(len(RUGS))[:3]),
        art=int(rng.integers(84)),
    )


def _views(rng: Generator, frame: int) -> tuple[int, int]:
    """Chooses matching views at random for two directions, and returns the variants of the windows."""
    outlook, turn = int(rng.integers(len(OUTLOOKS))), int(rng.integers(len(OUTLOOKS)))
    near = next(group for group in _SURROUNDINGS if OUTLOOKS[outlook] in group)
    other = near[(near.index(OUTLOOKS[outlook]) + turn) % len(near)]
    return frame + outlook, frame + OUTLOOKS.index(other)


def _one(rng: Generator, choices: Sequence[Choice]) -> Choice:
    return choices[int(rng.integers(len(choices)))]


def _trim(rng: Generator) -> Trim:
    """Chooses at random the skirting, the door frames and, in two of five buildings, a dado of wood or paint."""
    skirting = _one(rng, (painted("White", 0.45), wood("Walnut"), wood("Oak")))
    frame = _one(rng, (wood("Oak"), painted("White", 0.45), wood("Walnut"), wood("Pale"), painted("LightGrey", 0.5)))
    if rng.random() > 0.4:
        return Trim(skirting=skirting, frame=frame)
    tint = _one(rng, ("#e6e2d8", "#8a6040", "#c4925a", "#7f8c7a", "#6f8296"))
    texture = _one(rng, ("Panelling", "Plaster"))
    dado = tinted(texture, f"Dado{texture}{tint[1:]}", colour=tint, tile_m=1.0, roughness=0.6)
    return Trim(skirting=skirting, frame=frame, dado=dado, dado_top_m=float(rng.choice((0.9, 1.05, 1.2))))


def _pick(
    rng: Generator, texture: str, prefix: str, tints: dict[str, str], tile_m: float, roughness: float
) -> SurfaceMaterial:
    name = _one(rng, list(tints))
    return tinted(texture, f"{prefix}{texture}{name}", colour=tints[name], tile_m=tile_m, roughness=roughness)


def _paint(rng: Generator, walls: tuple[str, ...], name: str) -> SurfaceMaterial:
    """Returns the material of a wall: a colour, and one of the textures at random."""
    texture = _one(rng, walls)
    return tinted(
        texture, f"Wall{texture}{name}", colour=_PAINT_TINTS[name], tile_m=_WALL_TILE_M.get(texture, 0.8), roughness=0.9
    )
