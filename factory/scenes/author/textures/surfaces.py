"""Recipes of procedural surface textures: wood, carpet, tiles, concrete, fabric, cardboard; 512 px square, seamless.

Each recipe draws an sRGB image from a random generator. Does not read or write files.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from numpy.random import Generator

from factory.scenes.author.textures.artwork import ARTWORK
from factory.scenes.author.textures.decor import DECOR
from factory.scenes.author.textures.landscapes import LANDSCAPES
from factory.scenes.author.textures.noise import TEXTURE_SIZE, Pixels, clouds, grid, shade
from factory.scenes.author.textures.paintings import PAINTINGS
from factory.scenes.author.textures.rugs import RUGS
from factory.scenes.author.textures.views import VIEWS
from schemas.support.numpy_types import Floats


def _wood(base: str) -> Callable[[Generator], Pixels]:
    def draw(rng: Generator) -> Pixels:
        grain = clouds(rng, 1.3, stretch=14.0)
        rings = np.sin(grain * 4.0 + clouds(rng, 2.0, stretch=4.0))
        return shade(base, 1.0 + 0.07 * grain + 0.05 * rings)

    return draw


def _planks(base: str) -> Callable[[Generator], Pixels]:
    def draw(rng: Generator) -> Pixels:
        rows, columns = grid()
        plank = (rows // 64).astype(int)
        offset = rng.integers(0, TEXTURE_SIZE, 8)[plank]
        piece = ((columns + offset) % TEXTURE_SIZE // 256).astype(int)
        tone = 0.9 + 0.2 * rng.random((8, 2))[plank, piece] + 0.06 * clouds(rng, 1.3, stretch=14.0)
        tone[(rows % 64 < 2) | ((columns + offset) % 256 < 2)] *= 0.6
        return shade(base, tone)

    return draw


def _carpet(bases: tuple[str, ...]) -> Callable[[Generator], Pixels]:
    def draw(rng: Generator) -> Pixels:
        base = bases[int(rng.integers(len(bases)))]
        rows, columns = grid()
        checker = ((rows // 256 + columns // 256) % 2) * 0.05
        pile = 0.06 * clouds(rng, 0.25) + 0.015 * clouds(rng, 1.2) + checker
        pile[(rows % 256 < 2) | (columns % 256 < 2)] -= 0.08
        return shade(base, 0.98 + pile)

    return draw


def _tiles(base: str, grout: float, cells: int, mottle: float, spread: float = 0.025) -> Callable[[Generator], Pixels]:
    def draw(rng: Generator) -> Pixels:
        rows, columns = grid()
        pitch = TEXTURE_SIZE // cells
        cell_tone = rng.normal(1.0, spread, (cells, cells))
        tone = cell_tone[(rows // pitch).astype(int), (columns // pitch).astype(int)]
        tone = tone + mottle * clouds(rng, 1.8)
        tone[(rows % pitch < 4) | (columns % pitch < 4)] *= grout
        return shade(base, tone)

    return draw


def _mottled(base: str, coarse: float, fine: float, specks: float = 0.0) -> Callable[[Generator], Pixels]:
    def draw(rng: Generator) -> Pixels:
        tone = 1.0 + coarse * clouds(rng, 1.7) + fine * clouds(rng, 0.6)
        spots = rng.random(tone.shape)
        tone[spots < specks] *= 0.82
        tone[spots > 1 - specks] *= 1.12
        return shade(base, tone)

    return draw


def _concrete(base: str) -> Callable[[Generator], Pixels]:
    def draw(rng: Generator) -> Pixels:
        tone = 1.0 + 0.02 * clouds(rng, 1.6) + 0.022 * clouds(rng, 0.5)
        tone -= 0.05 * np.clip(clouds(rng, 2.0, stretch=9.0) - 1.4, 0, 1)  # tyre marks
        tone[rng.random(tone.shape) < 0.004] *= 0.8  # pits
        rows, columns = grid()
        tone[(rows < 2) | (columns < 2)] *= 0.62  # expansion joints
        tone[(rows == 2) | (columns == 2)] *= 1.08
        return shade(base, tone)

    return draw


def _weave(base: str) -> Callable[[Generator], Pixels]:
    def draw(rng: Generator) -> Pixels:
        rows, columns = grid()
        threads = np.sin(rows * np.pi / 4) * np.sin(columns * np.pi / 4)
        return shade(base, 1.0 + 0.10 * threads + 0.02 * clouds(rng, 0.9) + 0.03 * clouds(rng, 1.5))

    return draw


def _ribs(base: str, ribs: int) -> Callable[[Generator], Pixels]:
    def draw(rng: Generator) -> Pixels:
        _, columns = grid()
        wave = np.clip(np.sin(columns * 2 * np.pi * ribs / TEXTURE_SIZE) * 2.5, -1, 1)
        return shade(base, 0.95 + 0.05 * wave + 0.01 * clouds(rng, 1.9))

    return draw


def _plaster(rng: Generator) -> Pixels:
    """Rolled paint: a fine orange-peel texture with weak low-frequency noise, near white, for tinting."""
    tone = 0.965 + 0.012 * clouds(rng, 0.7) + 0.006 * clouds(rng, 1.5)
    return shade("#ffffff", np.minimum(tone, 1.0))


def _cardboard(rng: Generator) -> Floats:
    """The tone of an unprinted box face: corrugation, tape, dark edges."""
    rows, columns = grid()
    tone = 1.0 + 0.025 * clouds(rng, 1.4) + 0.012 * np.sin(columns * np.pi / 4)
    tone[(rows < 5) | (rows > 506) | (columns < 5) | (columns > 506)] *= 0.78
    return tone


def _carton(rng: Generator) -> Pixels:
    _, columns = grid()
    tone = _cardboard(rng)
    tone[np.abs(columns - 256) < 30] *= 1.14  # tape
    pixels = shade("#b48a5a", tone)
    pixels[330:430, 330:460] = 236  # label
    pixels[345:352, 340:430] = pixels[365:372, 340:450] = 40
    for bar in range(342, 440, 6):
        pixels[385:420, bar : bar + int(rng.integers(1, 5))] = 30
    return pixels


def _carton_printed(rng: Generator) -> Pixels:
    """A darker box with the symbols for "this side up" and "fragile", and a band of print."""
    rows, columns = grid()
    tone = _cardboard(rng)
    tone[np.abs(rows - 40) < 9] *= 1.15  # tape along the top
    pixels = shade("#a67c4e", tone)
    ink = np.zeros(rows.shape, bool)
    for left in (70, 160):
        ink |= (np.abs(columns - left - 30) < 9) & (rows > 330) & (rows < 430)
        ink |= (rows > 290) & (rows <= 330) & (np.abs(columns - left - 30) < (rows - 285) * 0.75)
    ink |= (rows > 438) & (rows < 448) & (columns > 60) & (columns < 232)
    ink |= (np.abs(rows - 150) < 26) & (columns > 90) & (columns < 420) & ((columns // 33) % 5 != 2)
    pixels[ink] = (pixels[ink] * 0.38).astype(np.uint8)
    return pixels


def _carton_white(rng: Generator) -> Pixels:
    """A bleached box with a coloured brand stripe and a code."""
    rows, columns = grid()
    pixels = shade("#dcd6c8", _cardboard(rng))
    stripe = ((40, 90, 150), (170, 60, 40), (40, 120, 80))[int(rng.integers(3))]
    pixels[(rows > 90) & (rows < 190)] = stripe
    pixels[(np.abs(rows - 140) < 18) & (columns > 60) & (columns < 300) & ((columns // 24) % 4 != 1)] = 240
    for bar in range(350, 460, 7):
        pixels[380:450, bar : bar + int(rng.integers(2, 6))] = 40
    return pixels


def _wrapped(rng: Generator) -> Pixels:
    """Cartons under stretch film: blurred boxes and slanted folds of the film."""
    rows, columns = grid()
    shift = (rows // 128 % 2) * 64
    boxes = rng.normal(1.0, 0.06, (5, 6))
    tone = boxes[(rows // 128).astype(int), ((columns + shift) // 128).astype(int)]
    tone[(rows % 128 < 5) | ((columns + shift) % 128 < 5)] *= 0.8
    folds = np.sin((rows * 0.4 + columns) * 0.045 + 1.6 * clouds(rng, 1.6))
    tone = tone * 0.75 + 0.27 + 0.05 * np.clip(folds - 0.75, 0, 1) * 4
    pixels = shade("#b3a68f", tone)
    pixels[370:450, 190:310] = 238
    for line in range(384, 440, 14):
        pixels[line : line + 5, 200 : 200 + int(rng.integers(50, 100))] = 60
    return pixels


def _tote(rng: Generator) -> Pixels:
    """The side of a moulded box, near white for tints: rim, ribs, a hand hole and a card slot."""
    rows, columns = grid()
    tone = 0.93 + 0.012 * clouds(rng, 1.0)
    tone[rows < 60] = 1.0
    tone[(rows >= 60) & (rows < 74)] = 0.55  # shade under the rim
    tone[(rows > 490) | (columns < 10) | (columns > 501)] *= 0.75
    rib = (columns % 128 < 14) & (rows > 74) & (rows < 490)
    tone[rib] = 1.0
    tone[(columns % 128 >= 14) & (columns % 128 < 22) & (rows > 74) & (rows < 490)] *= 0.78
    tone[(np.abs(rows - 135) < 24) & (np.abs(columns - 256) < 74)] = 0.18  # hand hole
    pixels = shade("#ffffff", np.minimum(tone, 1.0))
    pixels[300:390, 170:342] = (236, 234, 226)
    pixels[318:324, 186:310] = pixels[340:346, 186:326] = 70
    return pixels


def _door(base: str) -> Callable[[Generator], Pixels]:
    """An upright door leaf: veneer, frame grooves, a glass slit and a kick plate."""

    def draw(rng: Generator) -> Pixels:
        rows, columns = grid()
        grain = clouds(rng, 1.3, stretch=14.0).T
        tone = 1.0 + 0.06 * grain
        tone[(columns < 5) | (columns > 506) | (rows < 3) | (rows > 508)] *= 0.7
        pixels = shade(base, tone)
        glass = (columns > 380) & (columns < 440) & (rows > 70) & (rows < 250)
        rim = (columns > 370) & (columns < 450) & (rows > 62) & (rows < 258)
        pixels[rim] = (120, 124, 128)
        pixels[glass] = (
            (np.array([150, 172, 186]) * (0.8 + 0.3 * rows[glass] / 250)[:, None]).clip(0, 255).astype(np.uint8)
        )
        plate = rows > 462
        pixels[plate] = shade("#a8acb0", 1.0 + 0.03 * grain[plate])
        return pixels

    return draw


TEXTURES: Mapping[str, Callable[[Generator], Pixels]] = MappingProxyType(
    {
        "WoodOak": _wood("#c39a66"),
        "WoodWalnut": _wood("#7a5233"),
        "WoodPale": _wood("#d9c19a"),
        "WoodRough": _wood("#b3905f"),
        "FloorPlanks": _planks("#b08a5c"),
        "Carpet": _carpet(("#5d6b7d", "#6f6d68", "#56707a", "#7a6a5c")),
        "CarpetCorridor": _carpet(("#8b8a86", "#7d8a94", "#94897a")),
        "TileFloor": _tiles("#c9c6bd", 0.78, 4, 0.02),
        "TileWall": _tiles("#e3e6e4", 0.86, 8, 0.008),
        "CeilingTile": _tiles("#efeeea", 0.82, 2, 0.006, 0.006),
        "Linoleum": _mottled("#a3b3b2", 0.012, 0.03, 0.02),
        "LinoleumWarm": _mottled("#bba98c", 0.012, 0.03, 0.02),
        "Plaster": _plaster,
        "DoorLeaf": _door("#8a5f3c"),
        "Tote": _tote,
        "Wrapped": _wrapped,
        "Concrete": _concrete("#a9a8a3"),
        "WallPanel": _ribs("#cfd3d4", 16),
        "RollerDoor": _ribs("#9aa6ae", 16),
        "FabricBlue": _weave("#2f5597"),
        "FabricGrey": _weave("#7b7d80"),
        "FabricRed": _weave("#a32a26"),
        "FabricGreen": _weave("#3f7d4a"),
        "Carton": _carton,
        "CartonPrinted": _carton_printed,
        "CartonWhite": _carton_white,
        **ARTWORK,
        **DECOR,
        **RUGS,
        **LANDSCAPES,
        **PAINTINGS,
        **VIEWS,
    }
)
"""Name -> texture recipe, for all textures."""


def draw_texture(name: str, rng: Generator) -> Pixels:
    """Draws one texture.

    Returns:
        (512, 512, 3) uint8 sRGB, row 0 on top.
    """
    return TEXTURES[name](rng)
