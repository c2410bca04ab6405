"""Recipes of pictures for walls and screens: people, boats, plants, patterns, pupils' drawings.

Each recipe draws a square sRGB image of 512 px from a random generator. Does not read or write files.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from numpy.random import Generator
from PIL import Image, ImageDraw

from factory.scenes.author.textures.noise import Pixels
from factory.scenes.author.textures.views import SIZE, Canvas, between, sky


def _sheet(colour: str) -> Canvas:
    image = Image.new("RGB", (SIZE, SIZE), colour)
    return image, ImageDraw.Draw(image)


def _portrait(rng: Generator) -> Pixels:
    """A head and shoulders before a dark ground."""
    image, draw = _sheet(("#3b342c", "#2f3a3c", "#4a3230")[between(rng, 0, 3)])
    coat = ("#6b2f2c", "#2c4a63", "#4f5b3a")[between(rng, 0, 3)]
    draw.ellipse((60, 350, 452, 780), fill=coat)
    draw.polygon([(206, 360), (306, 360), (256, 460)], fill="#e9e2d2")
    draw.rectangle((222, 290, 290, 380), fill="#c99a78")
    draw.ellipse((166, 110, 346, 340), fill="#dcb08c")
    draw.pieslice((156, 84, 356, 320), 180, 360, fill=("#33261d", "#7a5433", "#b9b2a6")[between(rng, 0, 3)])
    for x in (216, 296):
        draw.ellipse((x - 11, 216, x + 11, 230), fill="#33302c")
    draw.arc((220, 250, 292, 296), 20, 160, fill="#8a4a40", width=6)
    return np.asarray(image)


def _boats(rng: Generator) -> Pixels:
    """Sailing boats at dusk."""
    image, draw = sky((74, 92, 140), (242, 190, 140), rng, 2)
    draw.rectangle((0, 300, SIZE, SIZE), fill="#40597a")
    for _ in range(5):
        x, y, size = between(rng, 40, 440), between(rng, 310, 430), between(rng, 40, 90)
        draw.polygon([(x, y), (x, y - 2 * size), (x + size, y)], fill="#f0e6d6")
        draw.polygon([(x - 6, y), (x - 6, y - size), (x - size // 2, y)], fill="#d98f5a")
        draw.polygon([(x - size, y + 6), (x + size, y + 6), (x + size // 2, y + 24), (x - size // 2, y + 24)],
                     fill="#5b2f2a")  # fmt: skip
    return np.asarray(image)


def _botany(rng: Generator) -> Pixels:
    """A stem with leaves, as in a herbarium."""
    image, draw = _sheet("#f2ecdc")
    draw.line((256, 470, 256, 70), fill="#4a6b3f", width=7)
    for step in range(7):
        y, reach = 110 + 52 * step, 60 + 14 * step
        for side in (-1, 1):
            x, green = 256 + side * reach, between(rng, 96, 140)
            corners = [(256, y + 30), (256 + side * reach // 2, y - 22), (x, y - 14), (256 + side * reach // 2, y + 26)]
            draw.polygon(corners, fill=(green - 36, green, green - 56))
    draw.rectangle((28, 28, 484, 484), outline="#8a7a5a", width=3)
    return np.asarray(image)


def _bands(rng: Generator) -> Pixels:
    """Broad level bands of paint."""
    image, draw = _sheet("#e9e0cf")
    colours = ("#223a4d", "#c86b4a", "#e3b45c", "#7d9a8c", "#f2ead8", "#8a3b3f")
    y = 0
    while y < SIZE:
        deep = between(rng, 30, 110)
        draw.rectangle((0, y, SIZE, y + deep), fill=colours[between(rng, 0, 6)])
        y += deep
    return np.asarray(image)


def _circles(rng: Generator) -> Pixels:
    """Rings in rows."""
    image, draw = _sheet(("#1f2a36", "#f0e9dc", "#d9c9a8")[between(rng, 0, 3)])
    colours = ("#d1495b", "#edae49", "#66a182", "#2e6f95", "#f4f1de")
    for row in range(4):
        for column in range(4):
            x, y = 64 + 128 * column, 64 + 128 * row
            for size in (56, 38, 20):
                draw.ellipse((x - size, y - size, x + size, y + size), fill=colours[between(rng, 0, 5)])
    return np.asarray(image)


def _birches(rng: Generator) -> Pixels:
    """White trunks before autumn leaves."""
    image, draw = _sheet("#d99a3e")
    for _ in range(420):
        x, y, r = between(rng, 0, SIZE), between(rng, 0, 380), between(rng, 6, 20)
        draw.ellipse((x, y, x + r, y + r), fill=("#e8b84a", "#c8742e", "#b5562a", "#8f9a4a")[between(rng, 0, 4)])
    draw.rectangle((0, 400, SIZE, SIZE), fill="#7a6a3e")
    for x in range(20, SIZE, 70):
        x, wide = x + between(rng, -16, 16), between(rng, 14, 30)
        draw.rectangle((x, 0, x + wide, 430), fill="#efece4")
        for y in range(between(rng, 10, 40), 430, 46):
            draw.line((x, y, x + wide // 2, y + 4), fill="#3a3632", width=5)
    return np.asarray(image)


def _cat(rng: Generator) -> Pixels:
    """A sitting cat in flat colours."""
    image, draw = _sheet(("#7fa3a8", "#d9a58c", "#c9b56a")[between(rng, 0, 3)])
    fur = ("#26262a", "#b5652e", "#8a8d90")[between(rng, 0, 3)]
    draw.ellipse((150, 240, 370, 540), fill=fur)
    draw.ellipse((176, 110, 344, 280), fill=fur)
    for x in (182, 338):
        draw.polygon([(x - 24, 150), (x, 60), (x + 24, 150)], fill=fur)
    for x in (226, 294):
        draw.ellipse((x - 15, 172, x + 15, 200), fill="#e6d45a")
        draw.ellipse((x - 4, 172, x + 4, 200), fill="#1a1a1a")
    draw.arc((330, 380, 470, 520), 180, 60, fill=fur, width=26)
    return np.asarray(image)


def _drawings(rng: Generator) -> Pixels:
    """Sheets with pupils' drawings on a pin board."""
    image, draw = _sheet("#b98d5a")
    for row in range(3):
        for column in range(4):
            x, y = 14 + 124 * column + between(rng, -6, 6), 16 + 164 * row + between(rng, -6, 6)
            draw.rectangle((x, y, x + 108, y + 140), fill=("#f6f3ea", "#f3e6c8", "#dfeaf0")[between(rng, 0, 3)])
            ink = ("#c8402f", "#2f6ac8", "#2f8a4a", "#d98a1f", "#7a3f9a")[between(rng, 0, 5)]
            cx, cy = x + 54, y + 60
            kind = between(rng, 0, 3)
            if kind == 0:
                draw.rectangle((cx - 30, cy, cx + 30, cy + 44), outline=ink, width=5)
                draw.polygon([(cx - 38, cy), (cx, cy - 36), (cx + 38, cy)], outline=ink, width=5)
            elif kind == 1:
                draw.ellipse((cx - 22, cy - 22, cx + 22, cy + 22), fill=ink)
                for step in range(8):
                    a = step * math.pi / 4
                    end = (cx + 42 * math.cos(a), cy + 42 * math.sin(a))
                    draw.line((cx + 28 * math.cos(a), cy + 28 * math.sin(a), *end), fill=ink, width=4)
            else:
                for _ in range(6):
                    points = [(x + between(rng, 10, 98), y + between(rng, 14, 120)) for _ in range(2)]
                    draw.line(points, fill=ink, width=5)
    return np.asarray(image)


def _alphabet(_rng: Generator) -> Pixels:
    """Coloured squares in a row, as cards of an alphabet."""
    image, draw = _sheet("#f6f2e6")
    for index in range(8):
        x = 64 * index
        draw.rectangle((x + 4, 40, x + 60, 472), fill=("#d1495b", "#edae49", "#66a182", "#2e6f95")[index % 4])
        draw.ellipse((x + 16, 150, x + 48, 330), fill="#f6f2e6")
    return np.asarray(image)


def _match(rng: Generator) -> Pixels:
    """A football match on a screen."""
    image, draw = _sheet("#3f8a45")
    for stripe in range(0, SIZE, 128):
        draw.rectangle((stripe, 90, stripe + 64, SIZE), fill="#4a9950")
    draw.rectangle((0, 0, SIZE, 90), fill="#6a7480")
    for _ in range(400):
        x, y = between(rng, 0, SIZE), between(rng, 0, 86)
        draw.rectangle((x, y, x + 4, y + 5), fill=("#c8ccd0", "#b5402f", "#2f4a8a", "#e0c04a")[between(rng, 0, 4)])
    draw.line((256, 90, 256, SIZE), fill="#eef2ee", width=4)
    draw.ellipse((176, 230, 336, 390), outline="#eef2ee", width=4)
    for _ in range(14):
        x, y = between(rng, 20, 490), between(rng, 110, 470)
        draw.rectangle((x, y, x + 9, y + 26), fill=("#b5201c", "#f2f2f2")[between(rng, 0, 2)])
    return np.asarray(image)


def _news(_rng: Generator) -> Pixels:
    """A news studio with a speaker and a line of text."""
    image, draw = _sheet("#24406a")
    draw.rectangle((250, 60, 490, 260), fill="#5f8fc0")
    draw.ellipse((80, 190, 270, 520), fill="#2b2f36")
    draw.ellipse((126, 90, 224, 216), fill="#d8ac88")
    draw.rectangle((0, 400, SIZE, 452), fill="#b5201c")
    for x in range(24, 470, 60):
        draw.rectangle((x, 418, x + 44, 434), fill="#f4f4f0")
    return np.asarray(image)


PAINTINGS: Mapping[str, Callable[[Generator], Pixels]] = MappingProxyType(
    {
        "PicturePortrait": _portrait,
        "PictureBoats": _boats,
        "PictureBotany": _botany,
        "PictureBands": _bands,
        "PictureCircles": _circles,
        "PictureBirches": _birches,
        "PictureCat": _cat,
        "PinDrawings": _drawings,
        "CardsAlphabet": _alphabet,
        "ScreenMatch": _match,
        "ScreenNews": _news,
    }
)
"""Name -> recipe of a picture or a screen."""
