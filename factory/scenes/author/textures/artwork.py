"""Recipes of drawn textures: monitor screens, posters, signs, scribbles, book spines, window views, hazard stripes.

Each recipe draws a square sRGB image of 512 px from a random generator. Does not read or write files.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
import numpy.typing as npt
from numpy.random import Generator
from PIL import Image, ImageDraw, ImageFont

Pixels = npt.NDArray[np.uint8]
Canvas = tuple[Image.Image, ImageDraw.ImageDraw]
SIZE = 512


def _canvas(colour: str) -> Canvas:
    image = Image.new("RGB", (SIZE, SIZE), colour)
    return image, ImageDraw.Draw(image)


def _between(rng: Generator, low: int, high: int) -> int:
    return int(rng.integers(low, high))


def _write(draw: ImageDraw.ImageDraw, text: str, y: int, size: int, colour: str) -> None:
    draw.text((SIZE // 2, y), text, fill=colour, font=ImageFont.load_default(size), anchor="mm")


def _code_screen(rng: Generator) -> Pixels:
    image, draw = _canvas("#15202e")
    draw.rectangle((0, 0, SIZE, 34), fill="#2d3b4e")
    draw.rectangle((0, 34, 96, SIZE), fill="#1c2a3b")
    for line in range(52, 492, 22):
        x = 116 + 26 * _between(rng, 0, 4)
        for _ in range(_between(rng, 1, 5)):
            width = _between(rng, 20, 90)
            colour = ("#7fd1ff", "#f2c66d", "#9be58f", "#e8eef4", "#e58fb0")[_between(rng, 0, 5)]
            draw.rectangle((x, line, min(x + width, 500), line + 9), fill=colour)
            x += width + 12
    return np.asarray(image)


def _desktop_screen(rng: Generator) -> Pixels:
    rows = np.linspace(0, 1, SIZE)[:, None, None]
    sky = np.array([70, 140, 220]) * (1 - rows) + np.array([190, 225, 245]) * rows
    image = Image.fromarray(np.broadcast_to(sky, (SIZE, SIZE, 3)).astype(np.uint8))
    draw = ImageDraw.Draw(image)
    for peak in range(4):
        x, height = _between(rng, 0, SIZE), _between(rng, 120, 240)
        colour = ("#3b6e8f", "#2f5d74", "#4b7f6b", "#2d6350")[peak]
        draw.polygon([(x - 300, SIZE), (x, SIZE - height), (x + 300, SIZE)], fill=colour)
    draw.rectangle((0, 482, SIZE, SIZE), fill="#20262e")
    draw.rectangle((60, 60, 330, 300), fill="#f4f6f8")
    draw.rectangle((60, 60, 330, 84), fill="#3d6fb5")
    return np.asarray(image)


def _chart_screen(rng: Generator) -> Pixels:
    image, draw = _canvas("#f3f5f7")
    draw.rectangle((0, 0, SIZE, 60), fill="#1f6f54")
    for row in range(90, 480, 30):
        draw.line((20, row, 492, row), fill="#d4dade", width=2)
    for bar in range(8):
        height = _between(rng, 80, 340)
        draw.rectangle((40 + bar * 56, 470 - height, 80 + bar * 56, 470), fill=("#3a7bd5", "#f08c2e")[bar % 2])
    return np.asarray(image)


def _poster_sun(rng: Generator) -> Pixels:
    image, draw = _canvas(("#f1d9b5", "#dbe7e4", "#f4e3d7")[_between(rng, 0, 3)])
    x, y = _between(rng, 150, 360), _between(rng, 120, 220)
    draw.ellipse((x - 90, y - 90, x + 90, y + 90), fill="#e2683c")
    for band, colour in enumerate(("#2f6f7e", "#3f8f8a", "#7fb59a")):
        draw.rectangle((0, 330 + band * 60, SIZE, SIZE), fill=colour)
    _write(draw, "SUMMER TOUR", 480, 40, "#f7f2e6")
    return np.asarray(image)


def _poster_blocks(rng: Generator) -> Pixels:
    image, draw = _canvas("#f4f1ea")
    colours = ("#d1495b", "#edae49", "#00798c", "#30638e", "#2b2d42")
    for _ in range(9):
        x, y = _between(rng, 20, 380), _between(rng, 20, 380)
        extent = (x, y, x + _between(rng, 60, 180), y + _between(rng, 60, 180))
        draw.rectangle(extent, fill=colours[_between(rng, 0, 5)])
    return np.asarray(image)


def _poster_hills(rng: Generator) -> Pixels:
    """A misty mountain photograph: ridges that darken towards the viewer."""
    rows = np.linspace(0, 1, SIZE)[:, None]
    sky = np.array([236, 178, 130]) * (1 - rows[..., None]) + np.array([250, 226, 190]) * rows[..., None]
    pixels = np.broadcast_to(sky, (SIZE, SIZE, 3)).copy()
    across = np.arange(SIZE)
    for ridge in range(5):
        waves = sum(np.sin(across * (k + 1) * 0.011 + float(rng.uniform(0, 6.28))) * 46 / (k + 1) for k in range(5))
        crest = 200 + 62 * ridge + waves
        shade = np.array([168, 168, 178]) * (1 - ridge / 5) + np.array([34, 60, 66]) * ridge / 5
        pixels[np.arange(SIZE)[:, None] > crest[None]] = shade
    return pixels.clip(0, 255).astype(np.uint8)


def _poster_arcs(rng: Generator) -> Pixels:
    image, draw = _canvas("#efe6d8")
    colours = ("#b5533c", "#d99a4e", "#37585f", "#8aa39b", "#2d3142")
    for row in range(3):
        for column in range(3):
            x, y, turn = 16 + column * 160, 16 + row * 160, 90 * _between(rng, 0, 4)
            for ring, size in enumerate((150, 104, 58)):
                colour = colours[(row * 2 + column + ring) % 5]
                inset = (150 - size) // 2
                draw.pieslice((x + inset, y + inset, x + inset + size, y + inset + size), turn, turn + 180, fill=colour)
    return np.asarray(image)


def _poster_city(rng: Generator) -> Pixels:
    image, draw = _canvas("#16213a")
    draw.ellipse((330, 50, 420, 140), fill="#f3e7c2")
    for layer, colour in enumerate(("#26365a", "#33507c", "#0f1626")):
        x = -20
        while x < SIZE:
            width, top = _between(rng, 36, 90), 180 + 70 * layer + _between(rng, -60, 60)
            draw.rectangle((x, top, x + width, SIZE), fill=colour)
            for window in range(_between(rng, 4, 12)):
                wx, wy = x + 6 + 12 * (window % 3), top + 12 + 22 * (window // 3)
                draw.rectangle((wx, wy, wx + 5, wy + 9), fill="#f6cf73")
            x += width + 4
    return np.asarray(image)


def _poster_type(rng: Generator) -> Pixels:
    image, draw = _canvas(("#d8482f", "#2456a6", "#e2b13c")[_between(rng, 0, 3)])
    for line, text in enumerate(("MAKE", "GOOD", "WORK")):
        _write(draw, text, 110 + 130 * line, 140, "#f7f3ea")
    draw.rectangle((60, 456, 452, 466), fill="#f7f3ea")
    return np.asarray(image)


def _floor_plan(rng: Generator) -> Pixels:
    """An escape plan: rooms along a corridor, green arrows, and a red dot at the reader's position."""
    image, draw = _canvas("#fafaf6")
    draw.rectangle((0, 0, SIZE, 70), fill="#1e7d4f")
    _write(draw, "ESCAPE PLAN", 36, 44, "#ffffff")
    draw.rectangle((30, 230, 482, 300), outline="#404448", width=4)
    for top, bottom in ((110, 230), (300, 430)):
        x = 30
        while x < 440:
            width = min(_between(rng, 70, 130), 482 - x)
            draw.rectangle((x, top, x + width, bottom), outline="#404448", width=4)
            x += width
    for x in range(60, 440, 70):
        draw.polygon([(x, 258), (x + 30, 258), (x + 30, 248), (x + 50, 265), (x + 30, 282), (x + 30, 272), (x, 272)],
                     fill="#1e9d4f")  # fmt: skip
    draw.ellipse((236, 150, 262, 176), fill="#c3211d")
    return np.asarray(image)


def _notice(heading: str, colour: str) -> Callable[[Generator], Pixels]:
    def draw_notice(rng: Generator) -> Pixels:
        image, draw = _canvas("#fbfbf8")
        draw.rectangle((0, 0, SIZE, 130), fill=colour)
        _write(draw, heading, 66, 64, "#ffffff")
        for line in range(180, 480, 36):
            draw.rectangle((50, line, 50 + _between(rng, 220, 410), line + 12), fill="#8b9096")
        return np.asarray(image)

    return draw_notice


def _sign(text: str, colour: str, size: int) -> Callable[[Generator], Pixels]:
    def draw_sign(_rng: Generator) -> Pixels:
        image, draw = _canvas(colour)
        draw.rectangle((14, 14, 497, 497), outline="#ffffff", width=10)
        _write(draw, text, 256, size, "#ffffff")
        return np.asarray(image)

    return draw_sign


def _scribbles(rng: Generator) -> Pixels:
    image, draw = _canvas("#f4f5f4")
    for x, y in ((40, 70), (60, 250), (300, 330), (50, 400)):
        x, y = x + _between(rng, -20, 30), y + _between(rng, -20, 30)
        draw.rectangle((x, y, x + 110, y + 60), outline="#2b59b5", width=4)
        draw.line((x + 110, y + 30, x + 180, y + 50), fill="#333333", width=4)
    for line in range(70, 240, 34):
        points = [(300 + step * 8, line + _between(rng, -7, 8)) for step in range(_between(rng, 10, 24))]
        draw.line(points, fill=("#222222", "#b32424", "#1e7a3a")[_between(rng, 0, 3)], width=3)
    return np.asarray(image)


def _spines(*colours: str) -> Callable[[Generator], Pixels]:
    """Returns the recipe of a row of books with backs of eight colours."""

    def draw_spines(rng: Generator) -> Pixels:
        image, draw = _canvas("#2a2522")
        x = 0
        while x < SIZE:
            width, top = _between(rng, 24, 52), _between(rng, 0, 90)
            draw.rectangle((x, top, x + width - 3, SIZE), fill=colours[_between(rng, 0, 8)])
            draw.rectangle((x + 5, top + 60, x + width - 8, top + 76), fill="#e8dcc0")
            x += width
        return np.asarray(image)

    return draw_spines


def _window(rng: Generator) -> Pixels:
    """A hazy view from an upper floor: sky with clouds, two rows of buildings with windows, trees in front."""
    rows = np.linspace(0, 1, SIZE)[:, None, None]
    sky = np.array([128, 178, 230]) * (1 - rows) + np.array([238, 243, 247]) * rows
    image = Image.fromarray(np.broadcast_to(sky, (SIZE, SIZE, 3)).astype(np.uint8))
    draw = ImageDraw.Draw(image)
    for _ in range(5):
        x, y = _between(rng, -40, SIZE), _between(rng, 30, 190)
        for _ in range(9):
            dx, dy, size = _between(rng, -50, 50), _between(rng, -10, 11), _between(rng, 14, 34)
            draw.ellipse((x + dx - 2 * size, y + dy - size // 2, x + dx + 2 * size, y + dy + size // 2), fill="#f1f5f9")
    for far, (low, high) in enumerate(((150, 290), (70, 190))):
        x = -10
        while x < SIZE:
            width, height = _between(rng, 46, 110), _between(rng, low, high)
            tone = _between(rng, 176, 204) - 44 * far
            warm = _between(rng, -8, 12)
            draw.rectangle((x, SIZE - height, x + width, SIZE), fill=(tone + warm, tone, tone + 10 - warm))
            for wy in range(SIZE - height + 10, SIZE - 8, 16):
                for wx in range(x + 7, x + width - 8, 14):
                    shade = tone - 34 + _between(rng, 0, 20)
                    draw.rectangle((wx, wy, wx + 7, wy + 9), fill=(shade, shade + 6, shade + 16))
            x += width + _between(rng, 0, 14)
    for _ in range(26):
        x, top, size = _between(rng, 0, SIZE), SIZE - _between(rng, 6, 50), _between(rng, 16, 36)
        green = _between(rng, 96, 132)
        draw.ellipse((x - size, top, x + size, top + 2 * size), fill=(green - 38, green, green - 48))
    return np.asarray(image)


def _hazard(rng: Generator) -> Pixels:
    rows, columns = np.indices((SIZE, SIZE))
    stripe = ((rows + columns) // 128) % 2 == 0
    wear = rng.random((SIZE, SIZE)) * 18
    yellow = np.stack([236 - wear, 190 - wear, 28 + 0 * wear], axis=-1)
    black = np.stack([34 + wear] * 3, axis=-1)
    return np.where(stripe[..., None], yellow, black).astype(np.uint8)


def _keys(_rng: Generator) -> Pixels:
    image, draw = _canvas("#202226")
    for row in range(5):
        for column in range(14):
            x, y = 12 + column * 35, 20 + row * 96
            draw.rectangle((x, y, x + 29, y + 80), fill="#3c4046")
    return np.asarray(image)


ARTWORK: Mapping[str, Callable[[Generator], Pixels]] = MappingProxyType(
    {
        "ScreenCode": _code_screen,
        "ScreenDesktop": _desktop_screen,
        "ScreenChart": _chart_screen,
        "PosterSun": _poster_sun,
        "PosterBlocks": _poster_blocks,
        "PosterHills": _poster_hills,
        "PosterArcs": _poster_arcs,
        "PosterCity": _poster_city,
        "PosterType": _poster_type,
        "NoticePlan": _floor_plan,
        "NoticeGreen": _notice("HYGIENE", "#2f8f6b"),
        "NoticeBlue": _notice("NOTICE", "#1f5fa8"),
        "NoticeSafety": _notice("SAFETY", "#1e7d4f"),
        "SignExit": _sign("EXIT", "#1b8a4a", 170),
        "SignFire": _sign("FIRE", "#c3211d", 170),
        "SignWard": _sign("WARD", "#2a6fb0", 140),
        "SignAisle": _sign("AISLE", "#234a86", 130),
        "Scribbles": _scribbles,
        "BookSpines": _spines("#8c2f2f", "#2f4f8c", "#d8c9a3", "#3f6f4a", "#c27b2c", "#5b3f73", "#e4e2dc", "#30343a"),
        "SpinesPale": _spines("#d8c9a3", "#b7c4c9", "#e4d8c8", "#c9a98a", "#a9b59a", "#e4e2dc", "#c98f7a", "#8fa3b0"),
        "SpinesLeather": _spines(
            "#5a3322", "#6b3f2a", "#43281e", "#7a4a2e", "#39302c", "#5a2626", "#2f3a33", "#6a5238"
        ),
        "SpinesBright": _spines("#d1402f", "#2f7ad1", "#e3b52c", "#3fa35a", "#e3782c", "#8a4fb0", "#f0eee6", "#2fa3a8"),
        "WindowView": _window,
        "Hazard": _hazard,
        "Keys": _keys,
    }
)
"""Drawn texture recipes by name."""
