"""Recipes of textures for layouts: floors, walls, wood and cloth, near white for tints.

Each recipe draws a seamless sRGB image of 512 px. Does not read or write files.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from numpy.random import Generator

from factory.scenes.author.textures.noise import TEXTURE_SIZE, Pixels, clouds, grid, shade
from schemas.support.numpy_types import Floats

Recipe = Callable[[Generator], Pixels]
_LIGHT = "#ffffff"


def _near_white(draw: Callable[[Generator, Floats, Floats], Floats]) -> Recipe:
    """Returns the recipe of a light texture, for materials with a tint; `draw` returns the tone of each pixel, 0..1."""

    def recipe(rng: Generator) -> Pixels:
        return shade(_LIGHT, np.clip(draw(rng, *grid()), 0.0, 1.0))

    return recipe


def _boards(rng: Generator, rows: Floats, columns: Floats) -> Floats:
    """Eight floor boards per tile, with joints at random places."""
    board = (rows // 64).astype(int)
    offset = rng.integers(0, TEXTURE_SIZE, 8)[board]
    piece = ((columns + offset) % TEXTURE_SIZE // 256).astype(int)
    tone: Floats = 0.82 + 0.14 * rng.random((8, 2))[board, piece] + 0.035 * clouds(rng, 1.3, stretch=14.0)
    tone[(rows % 64 < 2) | ((columns + offset) % 256 < 2)] *= 0.62
    return tone


def _herringbone(rng: Generator, rows: Floats, columns: Floats) -> Floats:
    """Parquet of blocks 128 x 32 px, alternately along both axes."""
    slot = ((columns + rows) // 32 % 8).astype(int)
    is_across = slot < 4
    tone = 0.84 + 0.02 * clouds(rng, 0.8)
    tone += np.where(is_across, 0.05, -0.04) + 0.07 * (rng.random((16, 16))[
        (rows // 32).astype(int), (columns // 128 * 4).astype(int)] - 0.5)  # fmt: skip
    tone[(rows % 32 < 1.5) & is_across | (columns % 32 < 1.5) & ~is_across] *= 0.68
    return tone


def _squares(cells: int, grout: float, mottle: float) -> Callable[[Generator, Floats, Floats], Floats]:
    def tone_of(rng: Generator, rows: Floats, columns: Floats) -> Floats:
        pitch = TEXTURE_SIZE // cells
        tone = 0.93 + 0.03 * rng.standard_normal((cells, cells))[(rows // pitch).astype(int),
                                                                (columns // pitch).astype(int)]  # fmt: skip
        tone = tone + mottle * clouds(rng, 1.8)
        tone[(rows % pitch < 4) | (columns % pitch < 4)] *= grout
        return np.asarray(tone)

    return tone_of


def _chequer(rng: Generator, rows: Floats, columns: Floats) -> Floats:
    """Tiles of two tones."""
    tone = np.where((rows // 128 + columns // 128) % 2 > 0, 0.97, 0.42) + 0.012 * clouds(rng, 1.5)
    tone[(rows % 128 < 3) | (columns % 128 < 3)] *= 0.8
    return np.asarray(tone)


def _terrazzo(rng: Generator, rows: Floats, columns: Floats) -> Floats:  # noqa: ARG001
    """Pale stone with dark and light chips."""
    chips = clouds(rng, 0.9)
    tone = 0.88 + 0.015 * clouds(rng, 1.8)
    tone[chips > 1.5] = 0.62
    tone[chips < -1.7] = 0.99
    return tone


def _pile(rng: Generator, rows: Floats, columns: Floats) -> Floats:  # noqa: ARG001
    """Carpet without tiles."""
    return 0.88 + 0.045 * clouds(rng, 0.25) + 0.02 * clouds(rng, 1.4)


def _bricks(rng: Generator, rows: Floats, columns: Floats) -> Floats:
    """Painted or bare bricks in a running bond."""
    course = (rows // 64).astype(int)
    shifted = columns + 64 * (course % 2)
    brick = (shifted % TEXTURE_SIZE // 128).astype(int)
    tone: Floats = 0.8 + 0.16 * rng.random((8, 4))[course, brick] + 0.03 * clouds(rng, 0.8)
    tone[(rows % 64 < 6) | (shifted % 128 < 6)] = 0.97
    return tone


def _stripes(rng: Generator, rows: Floats, columns: Floats) -> Floats:  # noqa: ARG001
    """Wallpaper with broad vertical stripes."""
    return np.where(columns // 64 % 2 > 0, 0.985, 0.90) + 0.008 * clouds(rng, 0.8)


def _damask(rng: Generator, rows: Floats, columns: Floats) -> Floats:
    """Wallpaper with a lattice of leaves."""
    u, v = columns * 2 * np.pi / 128, rows * 2 * np.pi / 128
    ornament = np.cos(u) * np.cos(v) + 0.5 * np.cos(2 * u + np.cos(v)) + 0.35 * np.cos(3 * v)
    return np.where(ornament > 0.55, 0.90, 0.975) + 0.008 * clouds(rng, 0.8)


def _grain(rng: Generator, rows: Floats, columns: Floats) -> Floats:  # noqa: ARG001
    """Wood, for tints of furniture."""
    grain = clouds(rng, 1.3, stretch=14.0)
    return 0.88 + 0.05 * grain + 0.03 * np.sin(grain * 4.0 + clouds(rng, 2.0, stretch=4.0))


def _cloth(rng: Generator, rows: Floats, columns: Floats) -> Floats:
    """Woven cloth, for tints of upholstery."""
    threads = np.sin(rows * np.pi / 4) * np.sin(columns * np.pi / 4)
    return np.asarray(0.9 + 0.07 * threads + 0.015 * clouds(rng, 0.9) + 0.02 * clouds(rng, 1.5))


def _basket_parquet(rng: Generator, rows: Floats, columns: Floats) -> Floats:
    """Parquet of squares of four blocks, alternately along both axes."""
    is_across = (rows // 128 + columns // 128) % 2 > 0
    block = np.where(is_across, rows // 32, columns // 32).astype(int)
    square = (rows // 128 * 4 + columns // 128).astype(int)
    tone = 0.84 + 0.12 * (rng.random((16, 16))[square, block % 16] - 0.5) + 0.02 * clouds(rng, 0.8)
    joint = np.where(is_across, rows % 32 < 1.5, columns % 32 < 1.5)
    tone[joint | (rows % 128 < 1.5) | (columns % 128 < 1.5)] *= 0.68
    return np.asarray(tone)


def _wide_boards(rng: Generator, rows: Floats, columns: Floats) -> Floats:
    """Four wide floor boards per tile, each with one joint."""
    board = (rows // 128).astype(int)
    tone: Floats = 0.86 + 0.12 * (rng.random(4)[board] - 0.5) + 0.05 * clouds(rng, 1.3, stretch=10.0)
    tone[(rows % 128 < 2.5) | ((columns + 256 * (board % 2)) % 512 < 2)] *= 0.6
    return tone


def _hexagons(rng: Generator, rows: Floats, columns: Floats) -> Floats:
    """Six-sided tiles in rows of eight."""
    pitch, step = 64.0, TEXTURE_SIZE / 10
    distances = []
    for shift, start in ((0.0, 0.0), (pitch / 2, step)):
        across = np.abs((columns - shift) % pitch - pitch / 2)
        down = np.abs((rows - start) % (2 * step) - step)
        distances += [np.hypot(across, down), np.hypot(pitch - across, down)]
    first, second = np.partition(np.stack(distances), 1, axis=0)[:2]
    return np.where(second - first < 4.5, 0.72, 0.93) + 0.015 * clouds(rng, 1.6)


def _marble(rng: Generator, rows: Floats, columns: Floats) -> Floats:
    """Large polished slabs with veins."""
    vein = np.exp(-np.abs(clouds(rng, 1.5)) / 0.06) + 0.6 * np.exp(-np.abs(clouds(rng, 1.7)) / 0.04)
    tone = 0.94 + 0.02 * clouds(rng, 1.8) - 0.16 * vein
    tone[(rows % 256 < 2) | (columns % 256 < 2)] *= 0.75
    return np.asarray(tone)


def _loop_pile(rng: Generator, rows: Floats, columns: Floats) -> Floats:
    """Carpet in narrow ribs."""
    ribs = 0.05 * np.sin(columns * np.pi / 8) + 0.02 * np.sin(rows * np.pi / 4)
    return np.asarray(0.87 + ribs + 0.03 * clouds(rng, 0.3))


def _subway(rng: Generator, rows: Floats, columns: Floats) -> Floats:
    """Glazed wall tiles, twice as wide as high, in a running bond."""
    course = (rows // 64).astype(int)
    shifted = columns + 64 * (course % 2)
    tone: Floats = 0.95 + 0.03 * (rng.random((8, 4))[course, (shifted % TEXTURE_SIZE // 128).astype(int)] - 0.5)
    tone[(rows % 64 < 4) | (shifted % 128 < 4)] = 0.78
    return tone


def _trellis(rng: Generator, rows: Floats, columns: Floats) -> Floats:
    """Wallpaper with a lattice of crossing lines."""
    lines = (np.abs((columns + rows) % 64 - 32) < 2.5) | (np.abs((columns - rows) % 64 - 32) < 2.5)
    return np.where(lines, 0.88, 0.975) + 0.008 * clouds(rng, 0.8)


def _spots(rng: Generator, rows: Floats, columns: Floats) -> Floats:
    """Wallpaper with dots in alternating rows."""
    shifted = columns + 32 * (rows // 64 % 2)
    dot = np.hypot(shifted % 64 - 32, rows % 64 - 32) < 9
    return np.where(dot, 0.86, 0.975) + 0.008 * clouds(rng, 0.8)


def _leaves(rng: Generator, rows: Floats, columns: Floats) -> Floats:
    """Wallpaper with climbing stems and leaves."""
    u, v = columns * 2 * np.pi / 128, rows * 2 * np.pi / 256
    stem = np.abs(np.sin(u / 2 + 0.7 * np.sin(v))) < 0.07
    leaf = np.sin(2 * u + 1.4 * np.sin(v)) * np.sin(6 * v + np.cos(u)) > 0.62
    return np.where(stem, 0.84, np.where(leaf, 0.88, 0.975)) + 0.008 * clouds(rng, 0.8)


def _panelling(rng: Generator, rows: Floats, columns: Floats) -> Floats:
    """Upright tongue-and-groove boards."""
    board = (columns // 64).astype(int)
    tone: Floats = 0.9 + 0.05 * (rng.random(8)[board] - 0.5) + 0.02 * clouds(rng, 1.3, stretch=14.0).T
    tone[columns % 64 < 3] *= 0.7
    tone[(columns % 64 >= 3) & (columns % 64 < 6) & (rows >= 0)] *= 1.05
    return tone


def _blocks(rng: Generator, rows: Floats, columns: Floats) -> Floats:
    """Painted concrete blocks with flush joints."""
    course = (rows // 128).astype(int)
    joint = (rows % 128 < 3) | ((columns + 128 * (course % 2)) % 256 < 3)
    return np.asarray(0.93 + 0.02 * clouds(rng, 0.6) + 0.01 * clouds(rng, 1.6) - 0.12 * joint)


def _carpet_tiles(rng: Generator, rows: Floats, columns: Floats) -> Floats:
    """Square carpet tiles, turned alternately."""
    is_turned = (rows // 256 + columns // 256) % 2 > 0
    ribs = 0.035 * np.where(is_turned, np.sin(columns * np.pi / 6), np.sin(rows * np.pi / 6))
    tone = 0.88 + ribs + np.where(is_turned, 0.03, -0.03) + 0.03 * clouds(rng, 0.25)
    tone[(rows % 256 < 2) | (columns % 256 < 2)] -= 0.1
    return np.asarray(tone)


def _vinyl(rng: Generator, rows: Floats, columns: Floats) -> Floats:  # noqa: ARG001
    """Seamless floor of hospitals, with fine chips."""
    tone = 0.93 + 0.012 * clouds(rng, 1.7) + 0.02 * clouds(rng, 0.6)
    spots = rng.random(tone.shape)
    tone[spots < 0.02] *= 0.84
    tone[spots > 0.985] = 1.0
    return np.asarray(tone)


def _screed(rng: Generator, rows: Floats, columns: Floats) -> Floats:
    """Ground concrete with clouds, tyre marks and expansion joints."""
    tone = 0.92 + 0.022 * clouds(rng, 1.6) + 0.018 * clouds(rng, 0.5)
    tone -= 0.06 * np.clip(clouds(rng, 2.0, stretch=9.0) - 1.3, 0, 1)
    tone[(rows < 2) | (columns < 2)] *= 0.62
    return np.asarray(tone)


def _sheeting(rng: Generator, rows: Floats, columns: Floats) -> Floats:  # noqa: ARG001
    """Trapezoidal metal sheets on the walls of a hall."""
    wave = np.clip(np.sin(columns * np.pi / 32) * 2.5, -1, 1)
    return np.asarray(0.93 + 0.05 * wave + 0.01 * clouds(rng, 1.9))


DECOR: Mapping[str, Recipe] = MappingProxyType(
    {
        "Boards": _near_white(_boards),
        "Herringbone": _near_white(_herringbone),
        "SquareTiles": _near_white(_squares(4, 0.8, 0.015)),
        "SmallTiles": _near_white(_squares(8, 0.78, 0.008)),
        "ChequerTiles": _near_white(_chequer),
        "Terrazzo": _near_white(_terrazzo),
        "Pile": _near_white(_pile),
        "Bricks": _near_white(_bricks),
        "WallpaperStripes": _near_white(_stripes),
        "WallpaperDamask": _near_white(_damask),
        "Grain": _near_white(_grain),
        "Cloth": _near_white(_cloth),
        "BasketParquet": _near_white(_basket_parquet),
        "WideBoards": _near_white(_wide_boards),
        "Hexagons": _near_white(_hexagons),
        "Marble": _near_white(_marble),
        "LoopPile": _near_white(_loop_pile),
        "SubwayTiles": _near_white(_subway),
        "WallpaperTrellis": _near_white(_trellis),
        "WallpaperDots": _near_white(_spots),
        "WallpaperLeaves": _near_white(_leaves),
        "Panelling": _near_white(_panelling),
        "BlockWork": _near_white(_blocks),
        "CarpetTiles": _near_white(_carpet_tiles),
        "Vinyl": _near_white(_vinyl),
        "Screed": _near_white(_screed),
        "Sheeting": _near_white(_sheeting),
    }
)
"""Name -> recipe of a texture near white, for tints."""
