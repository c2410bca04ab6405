"""Recipes of more window views: woods, snow, towers, park, desert, harbour and village.

Each recipe draws a square sRGB image of 512 px from a random generator. Does not read or write files.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from numpy.random import Generator
from PIL import ImageDraw

from factory.scenes.author.textures.noise import Pixels
from factory.scenes.author.textures.views import SIZE, Rgb, between, foliage, sky


def _conifer(draw: ImageDraw.ImageDraw, x: int, foot: int, high: int, colour: str | Rgb) -> None:
    """Draws a fir as three triangles on a trunk."""
    draw.rectangle((x - 3, foot - high // 6, x + 3, foot), fill="#4b382a")
    for level in range(3):
        top, half = foot - high + level * high // 4, (high // 7) * (level + 1)
        draw.polygon([(x, top), (x - half, top + high // 2), (x + half, top + high // 2)], fill=colour)


def _ridge(draw: ImageDraw.ImageDraw, rng: Generator, base: int, height: int, colour: str) -> None:
    phase = float(rng.uniform(0, 6.28))
    line = [(x, base - height * np.sin(x / 90 + phase) - 0.4 * height * np.sin(x / 31 + 2 * phase))
            for x in range(0, SIZE + 8, 8)]  # fmt: skip
    draw.polygon([*line, (SIZE, SIZE), (0, SIZE)], fill=colour)


def _woods(rng: Generator) -> Pixels:
    """Firs behind a meadow."""
    image, draw = sky((150, 184, 214), (228, 234, 232), rng, 2)
    for row, (foot, colour) in enumerate(((330, "#6f8a78"), (356, "#52735a"), (386, "#3a5c42"))):
        for x in range(-10, SIZE + 20, 34 + 10 * row):
            _conifer(
                draw, x + between(rng, -12, 12), foot=foot, high=120 + 46 * row + between(rng, -26, 26), colour=colour
            )
    draw.rectangle((0, 384, SIZE, SIZE), fill="#7d9a55")
    return np.asarray(image)


def _snow(rng: Generator) -> Pixels:
    """Snowy hills with single firs."""
    image, draw = sky((172, 196, 220), (236, 240, 244), rng, 2)
    for base, height, colour in ((270, 40, "#b9c8d6"), (330, 30, "#d3dde6"), (390, 22, "#eef2f5")):
        _ridge(draw, rng, base=base, height=height, colour=colour)
    for _ in range(9):
        _conifer(draw, between(rng, 10, 500), foot=between(rng, 380, 470), high=between(rng, 70, 130), colour="#4d6a5c")
    return np.asarray(image)


def _towers(rng: Generator) -> Pixels:
    """Office towers of glass and stone, close by."""
    image, draw = sky((120, 170, 224), (220, 232, 242), rng, 3)
    for layer, tones in enumerate((("#9fb4c6", "#b3bfc9"), ("#5f7f9c", "#8b8f94", "#a58f7a"))):
        x = -20
        while x < SIZE:
            width, top = between(rng, 60, 120), between(rng, 30, 190) + 90 * layer
            draw.rectangle((x, top, x + width, SIZE), fill=tones[between(rng, 0, len(tones))])
            for y in range(top + 10, SIZE, 20):
                draw.rectangle((x + 6, y, x + width - 6, y + 9), fill=("#c7d8e4", "#38536a")[layer])
            for column in range(x + 6, x + width, 18):
                draw.line((column, top, column, SIZE), fill=("#a9bac8", "#4d6c88")[layer], width=3)
            x += width + between(rng, 0, 30)
    return np.asarray(image)


def _park(rng: Generator) -> Pixels:
    """A pond with a path, benches and round trees."""
    image, draw = sky((126, 180, 232), (230, 240, 244), rng, 4)
    for x in range(-20, SIZE + 20, 40):
        foliage(draw, rng, x=x, y=296, size=34, count=10)
    draw.rectangle((0, 318, SIZE, SIZE), fill="#86a75e")
    draw.ellipse((90, 350, 400, 430), fill="#6f9fbd")
    draw.polygon([(420, 318), (450, 318), (560, SIZE), (380, SIZE)], fill="#cdbb98")
    for x in (between(rng, 20, 90), between(rng, 420, 500)):
        draw.rectangle((x - 7, 270, x + 7, 380), fill="#5b4632")
        foliage(draw, rng, x=x, y=236, size=58, count=40)
    return np.asarray(image)


def _desert(rng: Generator) -> Pixels:
    """Red mesas, sand and cacti."""
    image, draw = sky((96, 160, 226), (246, 226, 196), rng, 1)
    for x, width, top in ((60, 110, 230), (300, 150, 200), (440, 90, 250)):
        x += between(rng, -30, 30)
        draw.polygon([(x - width // 2 - 30, 330), (x - width // 2, top), (x + width // 2, top),
                      (x + width // 2 + 30, 330)], fill=("#b5684a", "#a45a42")[x % 2])  # fmt: skip
    for base, height, colour in ((330, 10, "#d9a86c"), (400, 16, "#e3ba80")):
        _ridge(draw, rng, base=base, height=height, colour=colour)
    for _ in range(5):
        x, foot, high = between(rng, 20, 490), between(rng, 370, 480), between(rng, 50, 110)
        for dx, low, top in ((0, foot, foot - high), (-14, foot - high // 3, foot - 2 * high // 3),
                             (14, foot - high // 4, foot - high // 2)):  # fmt: skip
            draw.line((x + dx, low, x + dx, top), fill="#5b7f4a", width=9)
        draw.line((x - 14, foot - high // 3, x + 14, foot - high // 4), fill="#5b7f4a", width=8)
    return np.asarray(image)


def _harbour(rng: Generator) -> Pixels:
    """Cranes, stacked containers and water."""
    image, draw = sky((150, 182, 208), (226, 232, 236), rng, 3)
    for x in (between(rng, 40, 140), between(rng, 300, 430)):
        draw.line((x, 380, x, 150), fill="#c8502e", width=10)
        draw.line((x - 70, 160, x + 120, 160), fill="#c8502e", width=9)
        draw.line((x, 110, x + 118, 158), fill="#8a8f94", width=3)
        draw.line((x + 90, 160, x + 90, 250), fill="#3c4046", width=2)
    colours = ("#b5402f", "#2f6aa8", "#3f8a5a", "#d99a2e", "#8a8f94")
    for row in range(3):
        for x in range(0, SIZE, 64):
            if rng.random() < 0.8 - 0.2 * row:
                y = 350 - 30 * row
                draw.rectangle((x + 2, y, x + 62, y + 28), fill=colours[between(rng, 0, 5)])
    draw.rectangle((0, 380, SIZE, SIZE), fill="#5b7f96")
    for _ in range(60):
        x, y = between(rng, 0, SIZE), between(rng, 386, SIZE)
        draw.line((x, y, x + between(rng, 10, 40), y), fill="#7d9db0", width=2)
    return np.asarray(image)


def _village(rng: Generator) -> Pixels:
    """Fields, a church and a few farm houses."""
    image, draw = sky((138, 184, 228), (240, 238, 228), rng, 4)
    for base, height, colour in ((280, 22, "#93ab84"), (330, 16, "#a8b56a"), (390, 12, "#c9b35a"), (450, 8, "#7f9c52")):
        _ridge(draw, rng, base=base, height=height, colour=colour)
    tower = between(rng, 150, 360)
    draw.rectangle((tower, 200, tower + 34, 320), fill="#e3ddd0")
    draw.polygon([(tower - 6, 200), (tower + 17, 120), (tower + 40, 200)], fill="#6b5148")
    for _ in range(6):
        x, y, width = between(rng, 0, 450), between(rng, 290, 350), between(rng, 40, 70)
        draw.rectangle((x, y, x + width, y + 34), fill=("#efe9dc", "#d8b48a", "#c7c2b8")[between(rng, 0, 3)])
        draw.polygon([(x - 6, y), (x + width // 2, y - 26), (x + width + 6, y)], fill="#95493a")
    return np.asarray(image)


LANDSCAPES: Mapping[str, Callable[[Generator], Pixels]] = MappingProxyType(
    {
        "ViewWoods": _woods,
        "ViewSnow": _snow,
        "ViewTowers": _towers,
        "ViewPark": _park,
        "ViewDesert": _desert,
        "ViewHarbour": _harbour,
        "ViewVillage": _village,
    }
)
"""Name -> recipe of a window view."""
