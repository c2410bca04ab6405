"""Builders of small objects that are not targets: books, crockery, flowers, candles, kettles, wall ledges, coat hooks.

Lengths in metres, front facing -y; things for tables have their foot at z = 0. Does not place props.
"""

from __future__ import annotations

import math

from numpy.random import Generator

from factory.scenes.author.geometry import (
    AuthoredMesh,
    block,
    card,
    cylinder,
    lathe,
    moved,
    open_block,
    quad,
    rod,
    standing_block,
)
from factory.scenes.author.materials import PropPiece, SurfaceMaterial, cloth, painted, wood

WHITE = painted("White", 0.45)
BLACK = painted("Black", 0.5)
STEEL = painted("Steel", 0.35, 1.0)
COVERS = tuple(painted(paint, 0.5) for paint in ("Red", "Navy", "Green", "Beige", "Orange", "Teal", "Purple", "Grey"))
GLAZES = tuple(painted(paint, 0.25) for paint in ("White", "SkyBlue", "Terracotta", "Teal", "Cream", "Navy"))
SPINES = tuple(
    SurfaceMaterial(name, "#5a4a44", name) for name in ("BookSpines", "SpinesPale", "SpinesLeather", "SpinesBright")
)
RUGS = ("RugTeal", "RugOchre", "RugPlum", "RugRed", "RugInk", "RugSand")


def book_pile(variant: int, rng: Generator) -> list[PropPiece]:
    """Two to five books on top of each other."""
    pieces, z = [], 0.0
    for number in range(2 + variant % 4):
        half_x, half_y = float(rng.uniform(0.08, 0.12)), float(rng.uniform(0.10, 0.14))
        thick = float(rng.uniform(0.018, 0.04))
        book = moved(standing_block((-half_x, -half_y, 0.0), (half_x, half_y, thick)), (0.0, 0.0, z),
                     yaw=float(rng.uniform(-0.35, 0.35)))  # fmt: skip
        pieces.append(PropPiece(COVERS[(variant + 3 * number) % len(COVERS)], book))
        z += thick
    return pieces


def book_row(variant: int, _rng: Generator) -> list[PropPiece]:
    """Upright books between two book ends."""
    half = (0.14, 0.20, 0.26)[variant % 3]
    books = open_block((-half, -0.08, 0.0), (half, 0.08, 0.22), "SENWT", fitted=True)
    ends = [block((x - 0.01, -0.06, 0.0), (x + 0.01, 0.06, 0.16)) for x in (-half - 0.011, half + 0.011)]
    return [PropPiece(SPINES[variant % 4], books), *(PropPiece(wood("Walnut"), end) for end in ends)]


def crockery(variant: int, _rng: Generator) -> list[PropPiece]:
    """A plate and a mug, or a tea pot with two cups."""
    glaze = GLAZES[variant % len(GLAZES)]
    if variant % 2:
        pot = lathe([(0.05, 0.0), (0.085, 0.05), (0.07, 0.11), (0.02, 0.13), (0.012, 0.15)], sides=10)
        spout = rod((0.06, 0.0, 0.05), (0.14, 0.0, 0.11), 0.014, 5)
        cups = [cylinder(0.03, 0.0, 0.06, at, 8, top=0.04) for at in ((-0.17, 0.05), (-0.15, -0.09))]
        return [PropPiece(glaze, mesh) for mesh in (pot, spout, *cups)]
    plate = lathe([(0.06, 0.0), (0.12, 0.018), (0.05, 0.012)], sides=12)
    mug = cylinder(0.035, 0.0, 0.09, (0.19, 0.06), 8)
    return [PropPiece(glaze, plate), PropPiece(GLAZES[(variant + 3) % len(GLAZES)], mug)]


def bouquet(variant: int, rng: Generator) -> list[PropPiece]:
    """Flowers in a glass or a jug."""
    petals = painted(("Red", "Yellow", "Pink", "White", "Purple", "Orange")[variant % 6], 0.8)
    jug = lathe([(0.035, 0.0), (0.055, 0.06), (0.03, 0.13), (0.04, 0.15)], sides=9)
    pieces = [PropPiece(GLAZES[(variant + 1) % len(GLAZES)], jug)]
    for step in range(7):
        a, lean, top = step * 2.4, float(rng.uniform(0.02, 0.10)), float(rng.uniform(0.24, 0.34))
        x, y = lean * math.cos(a), lean * math.sin(a)
        pieces.append(PropPiece(painted("Leaf"), rod((0.0, 0.0, 0.13), (x, y, top), 0.004, 3)))
        head = lathe([(0.008, top - 0.015), (0.030, top), (0.008, top + 0.02)], (x, y), 6)
        pieces.append(PropPiece(petals, head))
    return pieces


def fruit_bowl(variant: int, _rng: Generator) -> list[PropPiece]:
    """A bowl with fruit."""
    bowl = lathe([(0.06, 0.0), (0.15, 0.065), (0.13, 0.065), (0.05, 0.01)], sides=14)
    fruit = painted(("Red", "Green", "Orange", "Yellow")[variant % 4], 0.4)
    balls = [lathe([(0.01, 0.025), (0.04, 0.045), (0.04, 0.075), (0.01, 0.105)], at, 8)
             for at in ((0.04, 0.0), (-0.05, 0.03), (0.0, -0.06))]  # fmt: skip
    return [PropPiece(GLAZES[variant % len(GLAZES)], bowl), *(PropPiece(fruit, ball) for ball in balls)]


def candles(variant: int, _rng: Generator) -> list[PropPiece]:
    """Three candles on a plate."""
    wax = painted(("Cream", "DarkRed", "White", "Teal")[variant % 4], 0.7)
    sticks = [cylinder(0.022, 0.01, top, at, 8) for top, at in ((0.18, (0.0, 0.04)), (0.12, (-0.05, -0.02)),
                                                                (0.09, (0.05, -0.03)))]  # fmt: skip
    plate = cylinder(0.11, 0.0, 0.012, sides=12)
    return [PropPiece(BLACK, plate), *(PropPiece(wax, stick) for stick in sticks)]


def tray(variant: int, _rng: Generator) -> list[PropPiece]:
    """A tray with a bottle and glasses."""
    finish = (wood("Oak"), STEEL, painted("Red", 0.4))[variant % 3]
    glass = painted(("Green", "Teal", "Brown")[variant % 3], 0.15)
    bottle = lathe([(0.035, 0.015), (0.038, 0.17), (0.013, 0.22), (0.013, 0.28)], (-0.09, 0.0), 9)
    cups = [cylinder(0.026, 0.015, 0.10, at, 8, top=0.034) for at in ((0.05, 0.05), (0.11, -0.04))]
    board = block((-0.18, -0.12, 0.0), (0.18, 0.12, 0.015))
    return [PropPiece(finish, board), PropPiece(glass, bottle), *(PropPiece(WHITE, cup) for cup in cups)]


def kettle(variant: int, _rng: Generator) -> list[PropPiece]:
    """A kettle, a toaster, or jars."""
    paint = (STEEL, painted("Red", 0.3), painted("SkyBlue", 0.3), WHITE)[variant % 4]
    if variant % 3 == 1:
        body = block((-0.15, -0.08, 0.01), (0.15, 0.08, 0.19))
        slots = [open_block((-0.11, y - 0.012, 0.19), (0.11, y + 0.012, 0.193), "SENWT") for y in (-0.03, 0.03)]
        return [PropPiece(paint, body), *(PropPiece(BLACK, slot) for slot in slots)]
    if variant % 3 == 2:
        jars = [cylinder(0.05, 0.0, high, (x, 0.0), 9) for x, high in ((-0.12, 0.18), (0.0, 0.15), (0.12, 0.12))]
        lids = [
            cylinder(0.053, high, high + 0.02, (x, 0.0), 9) for x, high in ((-0.12, 0.18), (0.0, 0.15), (0.12, 0.12))
        ]
        return [*(PropPiece(paint, jar) for jar in jars), *(PropPiece(wood("Oak"), lid) for lid in lids)]
    body = lathe([(0.075, 0.0), (0.08, 0.06), (0.05, 0.19), (0.02, 0.20), (0.012, 0.22)], sides=12)
    handle = [
        rod((0.045, 0.0, 0.19), (0.13, 0.0, 0.18), 0.011, 5),
        rod((0.13, 0.0, 0.18), (0.085, 0.0, 0.05), 0.011, 5),
    ]
    return [PropPiece(paint, body), *(PropPiece(BLACK, bar) for bar in handle)]


def papers(variant: int, rng: Generator) -> list[PropPiece]:
    """Sheets of paper, a folder and a cup with pencils."""
    sheet = moved(standing_block((-0.105, -0.148, 0.0), (0.105, 0.148, 0.008)), yaw=float(rng.uniform(-0.4, 0.4)))
    folder = moved(standing_block((-0.11, -0.15, 0.0), (0.11, 0.15, 0.02)), (0.24, 0.02, 0.0), yaw=0.1)
    cup = cylinder(0.035, 0.0, 0.10, (-0.18, 0.08), 8)
    pencils = [
        rod((-0.18, 0.08, 0.02), (-0.18 + dx, 0.08 + dy, 0.17), 0.004, 3) for dx, dy in ((0.02, 0.0), (-0.02, 0.01))
    ]
    paint = COVERS[variant % len(COVERS)]
    return [
        PropPiece(WHITE, sheet),
        PropPiece(paint, folder),
        PropPiece(BLACK, cup),
        *(PropPiece(painted("Yellow"), pencil) for pencil in pencils),
    ]


def globe(variant: int, _rng: Generator) -> list[PropPiece]:
    """A globe on a foot."""
    ball = [(0.13 * math.sin(a), 0.19 - 0.13 * math.cos(a)) for a in (k * math.pi / 8 for k in range(9))]
    foot = lathe([(0.08, 0.0), (0.08, 0.012), (0.012, 0.03), (0.012, 0.07)], sides=10)
    paint = painted(("SkyBlue", "Blue", "Beige")[variant % 3], 0.4)
    return [PropPiece(paint, lathe(ball, sides=12)), PropPiece(wood("Walnut"), foot)]


def portrait(variant: int, _rng: Generator) -> list[PropPiece]:
    """A small framed photograph that leans on its stand."""
    art = ("PictureCat", "PictureBoats", "ViewSea", "PicturePortrait", "ViewVillage", "ViewPark")[variant % 6]
    half, high = ((0.07, 0.20), (0.10, 0.15))[variant % 2]
    plate = moved(block((-half, -0.006, 0.0), (half, 0.006, high)), roll=-0.18)
    photo = quad([(-half + 0.012, -0.0075, 0.012), (half - 0.012, -0.0075, 0.012),
                  (half - 0.012, -0.0075, high - 0.012), (-half + 0.012, -0.0075, high - 0.012)])  # fmt: skip
    frame = (BLACK, wood("Oak"), WHITE)[variant % 3]
    return [PropPiece(frame, plate), PropPiece(SurfaceMaterial(art, "#dcd2c0", art), moved(photo, roll=-0.18))]


def wall_ledge(variant: int, rng: Generator) -> list[PropPiece]:
    """A board on a wall with books, a jug and a photograph."""
    half, z = (0.35, 0.45, 0.55)[variant % 3], 1.45
    board = block((-half, -0.18, z - 0.025), (half, 0.0, z))
    books = open_block((-half + 0.02, -0.15, z), (0.0, -0.01, z + 0.21), "SENWT", fitted=True)
    jug = lathe([(0.03, z), (0.05, z + 0.06), (0.025, z + 0.14)], (0.14, -0.09), 8)
    box = standing_block((half - 0.14, -0.13, z), (half - 0.02, -0.03, z + float(rng.uniform(0.08, 0.16))))
    return [
        PropPiece((wood("Oak"), WHITE, wood("Walnut"))[variant % 3], board),
        PropPiece(SPINES[variant % 4], books),
        PropPiece(GLAZES[variant % len(GLAZES)], jug),
        PropPiece(COVERS[variant % len(COVERS)], box),
    ]


def coat_hooks(variant: int, rng: Generator) -> list[PropPiece]:
    """A strip of hooks on a wall with coats and a bag."""
    strip = block((-0.5, -0.025, 1.62), (0.5, 0.0, 1.70))
    pieces = [PropPiece((wood("Oak"), WHITE, wood("Walnut"))[variant % 3], strip)]
    for number, x in enumerate((-0.38, -0.13, 0.13, 0.38)):
        pieces.append(PropPiece(STEEL, rod((x, -0.02, 1.64), (x, -0.09, 1.66), 0.008, 4)))
        if rng.random() < 0.75:
            paint = ("Navy", "DarkRed", "Beige", "Green", "Grey", "Yellow")[(variant + 2 * number) % 6]
            pieces.append(PropPiece(cloth(paint), _coat(x, float(rng.uniform(0.75, 1.05)))))
    return pieces


def _coat(x: float, hem: float) -> AuthoredMesh:
    return lathe([(0.10, hem), (0.085, 1.35), (0.03, 1.62)], (x, -0.11), 7)


def tapestry(variant: int, _rng: Generator) -> list[PropPiece]:
    """A woven cloth on a wall."""
    name = RUGS[variant % len(RUGS)]
    half, low, high = ((0.45, 1.00, 2.10), (0.60, 1.15, 2.05), (0.38, 1.05, 2.15))[variant % 3]
    fabric = SurfaceMaterial(name, "#a08a70", name, roughness=0.95)
    bar = rod((-half - 0.05, -0.02, high), (half + 0.05, -0.02, high), 0.014, 5)
    sheet = quad([(-half, -0.02, low), (half, -0.02, low), (half, -0.02, high), (-half, -0.02, high)])
    return [PropPiece(fabric, sheet), PropPiece(wood("Walnut"), bar)]


def pin_board(variant: int, _rng: Generator) -> list[PropPiece]:
    """A board with pupils' drawings on a wall."""
    half = (0.70, 0.90, 1.10)[variant % 3]
    frame = (wood("Oak"), WHITE, painted("Blue", 0.5))[variant % 3]
    border = block((-half - 0.03, -0.03, 1.02), (half + 0.03, 0.0, 1.98))
    art = SurfaceMaterial("PinDrawings", "#b98d5a", "PinDrawings")
    face = quad([(-half, -0.0315, 1.05), (half, -0.0315, 1.05), (half, -0.0315, 1.95), (-half, -0.0315, 1.95)])
    return [PropPiece(frame, border), PropPiece(art, face)]


def card_frieze(variant: int, _rng: Generator) -> list[PropPiece]:
    """A row of printed cards high on a wall."""
    half = (1.2, 1.6, 0.8)[variant % 3]
    art = SurfaceMaterial("CardsAlphabet", "#c9a14a", "CardsAlphabet")
    low, high = 2.12, 2.34
    return [
        PropPiece(art, quad([(-half, -0.006, low), (half, -0.006, low), (half, -0.006, high), (-half, -0.006, high)]))
    ]


def flasks(variant: int, _rng: Generator) -> list[PropPiece]:
    """Bottles and a cup with brushes."""
    colours = ("SkyBlue", "Pink", "White", "Green", "Orange")
    bottles = [
        (
            colours[(variant + k) % 5],
            lathe([(0.022, 0.0), (0.024, high), (0.008, high + 0.03)], (0.065 * k - 0.08, 0.0), 7),
        )
        for k, high in enumerate((0.13, 0.09, 0.15))
    ]
    return [PropPiece(painted(paint, 0.3), mesh) for paint, mesh in bottles]


def pennants(variant: int, _rng: Generator) -> list[PropPiece]:
    """A line with coloured pennants, 3 m long and 2.35 to 2.6 m above the floor."""
    line = rod((-1.5, 0.0, 2.6), (1.5, 0.0, 2.6), 0.004, 3)
    pieces = [PropPiece(WHITE, line)]
    for number in range(12):
        x = -1.375 + 0.25 * number
        flag = card([(x - 0.09, 0.0, 2.59), (x + 0.09, 0.0, 2.59), (x, 0.0, 2.36)])
        paint = ("Red", "Yellow", "Blue", "White", "Green", "Orange")[(number + variant) % (2 + variant % 3)]
        pieces.append(PropPiece(painted(paint, 0.8), flag))
    return pieces
