"""Procedural surface textures: wood, carpet, tiles, concrete, fabric, cardboard and the like, 512 px square, seamless.

Each recipe turns a generator into sRGB pixels; never reads or writes a file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
import numpy.typing as npt
from numpy.random import Generator

from factory.scenes.author.artwork import ARTWORK

__all__ = ["TEXTURES", "TEXTURE_SIZE", "Pixels", "draw_texture"]

TEXTURE_SIZE = 512
Pixels = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float64]


def _clouds(rng: Generator, falloff: float, stretch: float = 1.0) -> Floats:
    """Seamless noise with zero mean and unit deviation; `stretch` > 1 draws it out along u."""
    white = np.fft.rfft2(rng.standard_normal((TEXTURE_SIZE, TEXTURE_SIZE)))
    down = np.fft.fftfreq(TEXTURE_SIZE)[:, None] * TEXTURE_SIZE
    across = np.fft.rfftfreq(TEXTURE_SIZE)[None] * TEXTURE_SIZE * stretch
    frequency = np.maximum(np.hypot(down, across), 1.0)
    noise = np.fft.irfft2(white / frequency**falloff, s=(TEXTURE_SIZE, TEXTURE_SIZE))
    noise -= noise.mean()
    return np.asarray(noise / noise.std())


def _shade(base: str, tone: Floats) -> Pixels:
    """Multiplies an sRGB base colour by a tone field around 1."""
    colour = np.array([int(base[start : start + 2], 16) for start in (1, 3, 5)], dtype=np.float64)
    return np.clip(tone[..., None] * colour, 0, 255).astype(np.uint8)


def _grid() -> tuple[Floats, Floats]:
    line = np.arange(TEXTURE_SIZE, dtype=np.float64)
    rows, columns = np.meshgrid(line, line, indexing="ij")
    return rows, columns


def _wood(base: str) -> Callable[[Generator], Pixels]:
    def draw(rng: Generator) -> Pixels:
        grain = _clouds(rng, 1.3, stretch=14.0)
        rings = np.sin(grain * 4.0 + _clouds(rng, 2.0, stretch=4.0))
        return _shade(base, 1.0 + 0.07 * grain + 0.05 * rings)

    return draw


def _planks(base: str) -> Callable[[Generator], Pixels]:
    def draw(rng: Generator) -> Pixels:
        rows, columns = _grid()
        plank = (rows // 64).astype(int)
        offset = rng.integers(0, TEXTURE_SIZE, 8)[plank]
        piece = ((columns + offset) % TEXTURE_SIZE // 256).astype(int)
        tone = 0.9 + 0.2 * rng.random((8, 2))[plank, piece] + 0.06 * _clouds(rng, 1.3, stretch=14.0)
        tone[(rows % 64 < 2) | ((columns + offset) % 256 < 2)] *= 0.6
        return _shade(base, tone)

    return draw


def _carpet(bases: tuple[str, ...]) -> Callable[[Generator], Pixels]:
    def draw(rng: Generator) -> Pixels:
        base = bases[int(rng.integers(len(bases)))]
        rows, columns = _grid()
        checker = ((rows // 256 + columns // 256) % 2) * 0.07
        pile = 0.03 * _clouds(rng, 0.8) + 0.03 * _clouds(rng, 1.4) + checker
        return _shade(base, 0.97 + pile)

    return draw


def _tiles(base: str, grout: float, cells: int, mottle: float, spread: float = 0.025) -> Callable[[Generator], Pixels]:
    def draw(rng: Generator) -> Pixels:
        rows, columns = _grid()
        pitch = TEXTURE_SIZE // cells
        cell_tone = rng.normal(1.0, spread, (cells, cells))
        tone = cell_tone[(rows // pitch).astype(int), (columns // pitch).astype(int)]
        tone = tone + mottle * _clouds(rng, 1.8)
        tone[(rows % pitch < 4) | (columns % pitch < 4)] *= grout
        return _shade(base, tone)

    return draw


def _mottled(base: str, coarse: float, fine: float, specks: float = 0.0) -> Callable[[Generator], Pixels]:
    def draw(rng: Generator) -> Pixels:
        tone = 1.0 + coarse * _clouds(rng, 1.7) + fine * _clouds(rng, 1.0)
        tone[rng.random(tone.shape) < specks] *= 0.72
        return _shade(base, tone)

    return draw


def _concrete(base: str) -> Callable[[Generator], Pixels]:
    def draw(rng: Generator) -> Pixels:
        tone = 1.0 + 0.04 * _clouds(rng, 1.9) + 0.006 * _clouds(rng, 1.2)
        tone[np.abs(_clouds(rng, 2.4)) < 0.008] *= 0.85  # hairline cracks
        rows, columns = _grid()
        tone[(rows < 3) | (columns < 3)] *= 0.72  # expansion joints
        return _shade(base, tone)

    return draw


def _weave(base: str) -> Callable[[Generator], Pixels]:
    def draw(rng: Generator) -> Pixels:
        rows, columns = _grid()
        threads = np.sin(rows * np.pi / 4) * np.sin(columns * np.pi / 4)
        return _shade(base, 1.0 + 0.10 * threads + 0.02 * _clouds(rng, 0.9) + 0.03 * _clouds(rng, 1.5))

    return draw


def _ribs(base: str, ribs: int) -> Callable[[Generator], Pixels]:
    def draw(rng: Generator) -> Pixels:
        _, columns = _grid()
        wave = np.clip(np.sin(columns * 2 * np.pi * ribs / TEXTURE_SIZE) * 2.5, -1, 1)
        return _shade(base, 0.95 + 0.05 * wave + 0.01 * _clouds(rng, 1.9))

    return draw


def _carton(rng: Generator) -> Pixels:
    rows, columns = _grid()
    tone = 1.0 + 0.03 * _clouds(rng, 1.7) + 0.01 * np.sin(columns * np.pi / 8)
    tone[np.abs(columns - 256) < 34] *= 1.16  # tape
    tone[(rows < 6) | (rows > 505) | (columns < 6) | (columns > 505)] *= 0.8
    pixels = _shade("#b48a5a", tone)
    pixels[330:430, 330:460] = 236  # label
    pixels[345:352, 340:430] = pixels[365:372, 340:450] = 40
    for bar in range(342, 440, 6):
        pixels[385:420, bar : bar + int(rng.integers(1, 5))] = 30
    return pixels


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
        "Linoleum": _mottled("#b9c6c4", 0.025, 0.012, 0.004),
        "LinoleumWarm": _mottled("#cdbfa6", 0.025, 0.012, 0.004),
        "Plaster": _mottled("#e4e1d8", 0.012, 0.003),
        "PlasterAccent": _mottled("#7f9bab", 0.012, 0.003),
        "Concrete": _concrete("#a9a8a3"),
        "WallPanel": _ribs("#cfd3d4", 16),
        "RollerDoor": _ribs("#9aa6ae", 16),
        "FabricBlue": _weave("#2f5597"),
        "FabricGrey": _weave("#7b7d80"),
        "FabricRed": _weave("#a32a26"),
        "FabricGreen": _weave("#3f7d4a"),
        "Carton": _carton,
        **ARTWORK,
    }
)
"""Every texture recipe by name."""


def draw_texture(name: str, rng: Generator) -> Pixels:
    """Draws one texture.

    Returns:
        (512, 512, 3) uint8 sRGB, row 0 on top.
    """
    return TEXTURES[name](rng)
