"""Recipes of window views and paintings: garden, suburb, hills, sea, street; abstract, still life, landscape, portrait.

Each recipe draws a square sRGB image of 512 px from a random generator. Does not read or write files.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from numpy.random import Generator
from PIL import Image, ImageDraw

from factory.scenes.author.textures.noise import Pixels

SIZE = 512
Canvas = tuple[Image.Image, ImageDraw.ImageDraw]
Rgb = tuple[int, int, int]


def sky(top: Rgb, bottom: Rgb, rng: Generator, clouds: int) -> Canvas:
    """Returns a canvas with a vertical gradient and clouds."""
    rows = np.linspace(0, 1, SIZE)[:, None, None]
    colours = np.array(top) * (1 - rows) + np.array(bottom) * rows
    image = Image.fromarray(np.broadcast_to(colours, (SIZE, SIZE, 3)).astype(np.uint8))
    draw = ImageDraw.Draw(image)
    for _ in range(clouds):
        x, y = between(rng, -20, SIZE), between(rng, 20, 170)
        for _ in range(8):
            dx, dy, size = between(rng, -50, 50), between(rng, -10, 11), between(rng, 12, 32)
            draw.ellipse((x + dx - 2 * size, y + dy - size // 2, x + dx + 2 * size, y + dy + size // 2), fill="#f3f6f9")
    return image, draw


def between(rng: Generator, low: int, high: int) -> int:
    """Returns a random integer from `low` to `high` - 1."""
    return int(rng.integers(low, high))


def foliage(draw: ImageDraw.ImageDraw, rng: Generator, x: int, y: int, size: int, count: int) -> None:
    """Draws a crown of leaves around a point."""
    for _ in range(count):
        dx, dy, r = between(rng, -size, size), between(rng, -size, size), between(rng, size // 5, size // 2)
        green = between(rng, 84, 136)
        draw.ellipse((x + dx - r, y + dy - r, x + dx + r, y + dy + r), fill=(green - 34, green, green - 52))


def _garden(rng: Generator) -> Pixels:
    """A lawn, a hedge and two trees."""
    image, draw = sky((120, 176, 232), (226, 238, 246), rng, 4)
    draw.rectangle((0, 330, SIZE, SIZE), fill="#7fa05a")
    for x in range(-10, SIZE + 20, 22):
        foliage(draw, rng, x=x, y=326, size=26, count=7)
    for x in (between(rng, 60, 200), between(rng, 300, 460)):
        draw.rectangle((x - 9, 230, x + 9, 380), fill="#5d4631")
        foliage(draw, rng, x=x, y=190, size=82, count=60)
    for _ in range(60):
        x, y = between(rng, 0, SIZE), between(rng, 360, 420)
        draw.ellipse((x, y, x + 6, y + 6), fill=("#e8e2f0", "#d8617c", "#f0cf4a")[between(rng, 0, 3)])
    return np.asarray(image)


def _suburb(rng: Generator) -> Pixels:
    """Gabled houses across a street."""
    image, draw = sky((146, 188, 232), (234, 240, 244), rng, 3)
    x = -30
    while x < SIZE:
        width, top = between(rng, 130, 190), between(rng, 210, 260)
        wall = ("#d9c7a6", "#c98f6f", "#e2ded2", "#a9b6b4")[between(rng, 0, 4)]
        draw.rectangle((x, top, x + width, 420), fill=wall)
        roof = ("#8a4b3a", "#5b5f66", "#7a5a44")[between(rng, 0, 3)]
        draw.polygon([(x - 12, top), (x + width // 2, top - 80), (x + width + 12, top)], fill=roof)
        for wx in (x + 22, x + width - 58):
            for wy in (top + 24, top + 100):
                draw.rectangle((wx, wy, wx + 36, wy + 44), fill="#f2f2ee")
                draw.rectangle((wx + 4, wy + 4, wx + 32, wy + 40), fill="#6f8799")
        x += width + between(rng, 14, 50)
    draw.rectangle((0, 416, SIZE, 440), fill="#86a05e")
    draw.rectangle((0, 440, SIZE, SIZE), fill="#83868a")
    for x in range(10, SIZE, 90):
        foliage(draw, rng, x=x + between(rng, 0, 40), y=404, size=24, count=12)
    return np.asarray(image)


def _hills(rng: Generator) -> Pixels:
    """Ridges of hills that pale with distance."""
    image, draw = sky((132, 178, 226), (240, 236, 224), rng, 3)
    for level, tone in enumerate(("#a9bccb", "#8fa9a6", "#7a9a78", "#5f8552")):
        base, phase = 250 + 62 * level, float(rng.uniform(0, 6.28))
        ridge = [(x, base - 34 * np.sin(x / 90 + phase) - 16 * np.sin(x / 37 + 2 * phase)) for x in range(0, 520, 8)]
        draw.polygon([*ridge, (SIZE, SIZE), (0, SIZE)], fill=tone)
    return np.asarray(image)


def _sea(rng: Generator) -> Pixels:
    """The sea with a far coast, boats and a beach."""
    image, draw = sky((104, 168, 232), (228, 240, 248), rng, 4)
    draw.rectangle((0, 290, SIZE, 430), fill="#3f7fa8")
    for _ in range(90):
        x, y = between(rng, 0, SIZE), between(rng, 296, 428)
        draw.line((x, y, x + between(rng, 10, 34), y), fill="#5f9cc0", width=2)
    draw.polygon([(0, 290), (110, 262), (240, 290)], fill="#7f9488")
    for _ in range(3):
        x, y = between(rng, 60, 460), between(rng, 310, 360)
        draw.polygon([(x, y), (x + 30, y), (x + 24, y + 9), (x + 6, y + 9)], fill="#f4f4f0")
        draw.polygon([(x + 14, y - 2), (x + 14, y - 38), (x + 32, y - 2)], fill="#fafaf8")
    draw.rectangle((0, 430, SIZE, SIZE), fill="#dcc79c")
    return np.asarray(image)


def _street(rng: Generator) -> Pixels:
    """Brick fronts with rows of windows, close by."""
    image, draw = sky((150, 186, 222), (226, 232, 238), rng, 2)
    x = 0
    while x < SIZE:
        width, top = between(rng, 110, 170), between(rng, 60, 140)
        red = between(rng, 120, 170)
        draw.rectangle((x, top, x + width, SIZE), fill=(red, red - 46, red - 62))
        draw.rectangle((x, top, x + width, top + 14), fill="#cfc7b8")
        for wy in range(top + 34, SIZE, 74):
            for wx in range(x + 14, x + width - 24, 42):
                draw.rectangle((wx, wy, wx + 24, wy + 46), fill="#e9e6de")
                draw.rectangle((wx + 3, wy + 3, wx + 21, wy + 43), fill="#4d5c68")
        x += width
    return np.asarray(image)


def _abstract(rng: Generator) -> Pixels:
    """Overlapping arcs and bars."""
    image = Image.new("RGB", (SIZE, SIZE), "#efe8da")
    draw = ImageDraw.Draw(image)
    colours = ("#c8553d", "#f0a23b", "#28536b", "#5b8e7d", "#2b2d42", "#d9b08c")
    for _ in range(7):
        x, y, r = between(rng, 0, SIZE), between(rng, 0, SIZE), between(rng, 60, 190)
        draw.pieslice((x - r, y - r, x + r, y + r), between(rng, 0, 180), between(rng, 200, 360),
                      fill=colours[between(rng, 0, 6)])  # fmt: skip
    for _ in range(4):
        x = between(rng, 0, 460)
        draw.rectangle((x, between(rng, 0, 300), x + between(rng, 6, 26), SIZE), fill=colours[between(rng, 0, 6)])
    return np.asarray(image)


def _still_life(rng: Generator) -> Pixels:
    """A vase with flowers on a table."""
    image = Image.new("RGB", (SIZE, SIZE), "#b9a98c")
    draw = ImageDraw.Draw(image)
    draw.rectangle((0, 380, SIZE, SIZE), fill="#6e4b32")
    draw.polygon([(210, 300), (300, 300), (330, 430), (180, 430)], fill="#3f6d8c")
    for _ in range(26):
        x, y, r = between(rng, 130, 380), between(rng, 90, 300), between(rng, 12, 30)
        draw.line((255, 305, x, y), fill="#4f6b3c", width=3)
        draw.ellipse(
            (x - r, y - r, x + r, y + r), fill=("#c9485b", "#e7c24d", "#efe9e0", "#8f5a9c")[between(rng, 0, 4)]
        )
    return np.asarray(image)


def _lake(rng: Generator) -> Pixels:
    """Mountains over a lake in the evening."""
    image, draw = sky((236, 176, 120), (250, 226, 190), rng, 0)
    for peak in range(5):
        x, height = 40 + 110 * peak + between(rng, -30, 30), between(rng, 110, 200)
        draw.polygon([(x - 150, 320), (x, 320 - height), (x + 150, 320)], fill=("#6b7fa0", "#54688a")[peak % 2])
    draw.rectangle((0, 320, SIZE, SIZE), fill="#7f95b4")
    for _ in range(70):
        x, y = between(rng, 0, SIZE), between(rng, 326, SIZE)
        draw.line((x, y, x + between(rng, 20, 60), y), fill="#e8bd92", width=2)
    return np.asarray(image)


def _offer(_rng: Generator) -> Pixels:
    """A poster of a special offer: a red disc with a percent sign."""
    image = Image.new("RGB", (SIZE, SIZE), "#f7d548")
    draw = ImageDraw.Draw(image)
    draw.ellipse((96, 96, 416, 416), fill="#c8281e")
    draw.line((200, 330, 312, 182), fill="#ffffff", width=26)
    for x, y in ((200, 206), (312, 306)):
        draw.ellipse((x - 34, y - 34, x + 34, y + 34), outline="#ffffff", width=18)
    return np.asarray(image)


def _world(rng: Generator) -> Pixels:
    """A world map on a wall: blue with green and sandy land."""
    image = Image.new("RGB", (SIZE, SIZE), "#9cc3dc")
    draw = ImageDraw.Draw(image)
    for x, y, w, h in ((70, 120, 90, 110), (110, 260, 60, 120), (240, 110, 70, 60), (250, 200, 80, 130),
                       (340, 110, 130, 120), (410, 320, 70, 50)):  # fmt: skip
        for _ in range(16):
            dx, dy, r = between(rng, -w // 2, w // 2), between(rng, -h // 2, h // 2), between(rng, 14, 34)
            colour = ("#8fae6a", "#c9b877", "#a8b97a")[between(rng, 0, 3)]
            draw.ellipse((x + dx - r, y + dy - r, x + dx + r, y + dy + r), fill=colour)
    for line in range(64, SIZE, 64):
        draw.line((line, 0, line, SIZE), fill="#dfeaf0", width=1)
        draw.line((0, line, SIZE, line), fill="#dfeaf0", width=1)
    return np.asarray(image)


VIEWS: Mapping[str, Callable[[Generator], Pixels]] = MappingProxyType(
    {
        "ViewGarden": _garden,
        "ViewSuburb": _suburb,
        "ViewHills": _hills,
        "ViewSea": _sea,
        "ViewStreet": _street,
        "PictureAbstract": _abstract,
        "PictureStillLife": _still_life,
        "PictureLake": _lake,
        "PosterOffer": _offer,
        "PosterWorld": _world,
    }
)
"""Name -> recipe of window views and pictures."""
