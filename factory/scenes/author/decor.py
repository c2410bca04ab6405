"""Recipes of textures for homes, shops and schools: floors, wallpaper and cloth near white for tints, and rugs.

Each recipe draws a seamless sRGB image of 512 px. Does not read or write files.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from numpy.random import Generator

from factory.scenes.author.noise import TEXTURE_SIZE, Pixels, clouds, grid, shade
from schemas.support.numpy_types import Floats

Recipe = Callable[[Generator], Pixels]
_LIGHT = "#ffffff"


def _near_white(draw: Callable[[Generator, Floats, Floats], Floats]) -> Recipe:
    """Returns a recipe whose tone of at most 1 is multiplied with the tint of a material."""

    def recipe(rng: Generator) -> Pixels:
        return shade(_LIGHT, np.clip(draw(rng, *grid()), 0.0, 1.0))

    return recipe


def _boards(rng: Generator, rows: Floats, columns: Floats) -> Floats:
    """Floor boards of 1/4 of the tile, with joints at random places."""
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


def _rug(field: str, border: str, accent: str, kind: int) -> Recipe:
    """Returns the recipe of a whole rug with a border: medallion, stripes or lozenges."""

    def draw(rng: Generator) -> Pixels:
        rows, columns = grid()
        x, y = np.abs(columns - 255.5), np.abs(rows - 255.5)
        pixels = np.broadcast_to(_rgb(field), (TEXTURE_SIZE, TEXTURE_SIZE, 3)).copy()
        if kind == 0:
            ring = np.hypot(x, y)
            mark = (ring < 70) | ((ring > 110) & (ring < 126)) | ((x % 64 < 14) & (y % 64 < 14) & (ring > 150))
        elif kind == 1:
            mark = (rows // 36 % 3 == 0) | (rows // 12 % 9 == 5)
        else:
            mark = (x + y) % 96 < 18
        pixels[mark] = _rgb(accent)
        edge = np.maximum(x, y)
        pixels[edge > 216] = _rgb(border)
        pixels[(edge > 228) & (edge < 236)] = _rgb(accent)
        tone = 0.95 + 0.05 * clouds(rng, 0.3)
        return np.clip(pixels * tone[..., None], 0, 255).astype(np.uint8)

    return draw


def _rgb(colour: str) -> Floats:
    return np.array([int(colour[start : start + 2], 16) for start in (1, 3, 5)], np.float64)


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
        "RugRed": _rug("#8c2f2c", "#5a1f24", "#d8b98a", 0),
        "RugBlue": _rug("#3a5a86", "#24395a", "#d9d4c4", 1),
        "RugCream": _rug("#d8cdb6", "#b09a78", "#7d6a50", 2),
        "RugGreen": _rug("#5d7355", "#39492f", "#d2c58f", 0),
        "RugGrey": _rug("#8e9092", "#5c5f63", "#d6d6d2", 1),
    }
)
"""Name -> recipe; the names before the rugs are near white."""
