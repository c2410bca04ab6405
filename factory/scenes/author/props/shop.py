"""Builders for shops: shelves with goods, checkouts, freezers, vending machines, clothes rails, mannequins, carts.

Lengths in metres, origin on the floor, front facing -y. Does not place props.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.random import Generator

from factory.scenes.author.geometry import (
    AuthoredMesh,
    block,
    cushion,
    cylinder,
    fitted_block,
    lathe,
    loft,
    moved,
    open_block,
    quad,
    rod,
    standing_block,
    tube,
    uncapped,
)
from factory.scenes.author.materials import PropPiece, SurfaceMaterial, cloth, glowing, painted, wood
from factory.scenes.author.props.storage import CARTONS

WHITE = painted("White", 0.45)
BLACK = painted("Black", 0.5)
STEEL = painted("Steel", 0.35, 1.0)
CHROME = painted("Chrome", 0.25, 1.0)
GREY = painted("LightGrey", 0.5)
GOODS = tuple(
    painted(paint, 0.5) for paint in ("Red", "Yellow", "Green", "Blue", "Orange", "White", "Purple", "SkyBlue", "Pink")
)
LIT = glowing("CaseLight", "#f4f8fa", glow=0.7)


def _row(z: float, half: float, deep: float, room: float, rng: Generator, y: float) -> list[PropPiece]:
    """A row of packets of a few kinds on a shelf, from -half to half."""
    pieces: list[PropPiece] = []
    x = -half
    while x < half - 0.1:
        width = min(float(rng.uniform(0.14, 0.34)), half - x)
        tall = room * float(rng.uniform(0.5, 0.92))
        low, high = (x + 0.006, y - deep, z), (x + width - 0.006, y + deep, z + tall)
        goods = GOODS[int(rng.integers(len(GOODS)))]
        if rng.random() < 0.25:
            pieces.append(PropPiece(CARTONS[int(rng.integers(4))], standing_block(low, high, fitted=True)))
        elif rng.random() < 0.35:
            radius = min(width / 2 - 0.01, deep)
            can = cylinder(radius, z, z + tall, (x + width / 2, y - deep + radius), 8)
            pieces.append(PropPiece(goods, can))
        else:
            pieces.append(PropPiece(goods, standing_block(low, high)))
        x += width
    return pieces


def gondola(variant: int, rng: Generator) -> list[PropPiece]:
    """A shop shelf 1.2 m wide with four levels of goods on its front, and on its back if it is deep."""
    frame = (WHITE, GREY, painted("Charcoal"))[variant % 3]
    half, deep, high = 0.6, (0.24, 0.42)[variant // 3 % 2], 1.5
    is_double = deep > 0.3
    spine = 0.0 if is_double else deep - 0.02
    meshes = [block((-half, spine - 0.015, 0.0), (half, spine + 0.015, high))]
    meshes.append(block((-half + 0.002, -deep, 0.0), (half - 0.002, spine - 0.015, 0.13)))
    pieces: list[PropPiece] = []
    levels = (0.13, 0.50, 0.85, 1.18)
    for number, z in enumerate(levels):
        reach = deep if number == 0 else deep - 0.05
        for sign in (-1.0, 1.0) if is_double else (-1.0,):
            edge = sign * reach
            inner = spine + 0.015 * sign
            y0, y1 = sorted((edge, inner))
            meshes.append(block((-half + 0.004, y0, z - 0.025), (half - 0.004, y1, z)))
            middle, width = (edge + inner) / 2, abs(edge - inner) / 2 - 0.03
            pieces += _row(z, half - 0.02, width, 0.29, rng, middle)
    return [*(PropPiece(frame, mesh) for mesh in meshes), *pieces]


def checkout(variant: int, _rng: Generator) -> list[PropPiece]:
    """A checkout counter 1.8 m long with a belt, a till and a screen."""
    stripe = painted(("Red", "Green", "Blue")[variant % 3], 0.45)
    body = block((-0.9, -0.32, 0.0), (0.9, 0.32, 0.86))
    band = open_block((-0.902, -0.335, 0.30), (0.902, -0.32, 0.55), "SEWBT")
    top = block((-0.93, -0.35, 0.86), (0.93, 0.35, 0.90))
    belt = open_block((-0.85, -0.22, 0.90), (0.15, 0.12, 0.905), "SENWT")
    till = cushion((0.35, -0.15, 0.90), (0.70, 0.20, 1.02), 0.02)
    screen = moved(block((-0.16, -0.012, 0.0), (0.16, 0.012, 0.24)), (0.52, 0.05, 1.08), yaw=math.pi)
    neck = block((0.50, 0.035, 1.02), (0.54, 0.065, 1.09))
    return [
        PropPiece(stripe, body),
        PropPiece(WHITE, band),
        PropPiece(GREY, top),
        PropPiece(painted("Rubber"), belt),
        PropPiece(BLACK, till),
        PropPiece(BLACK, screen),
        PropPiece(BLACK, neck),
    ]


def freezer(variant: int, rng: Generator) -> list[PropPiece]:
    """An upright refrigerated cabinet: lit shelves of bottles behind a front that a mullion divides."""
    case = (WHITE, painted("Red", 0.4), painted("Blue", 0.4))[variant % 3]
    shell = [
        block((-0.62, 0.26, 0.0), (0.62, 0.32, 1.95)),
        block((-0.62, -0.32, 1.72), (0.62, 0.26, 1.95)),
        block((-0.62, -0.32, 0.0), (0.62, 0.26, 0.30)),
        *(block((x - 0.03, -0.32, 0.30), (x + 0.03, 0.26, 1.72)) for x in (-0.59, 0.59)),
    ]
    pieces = [PropPiece(case, mesh) for mesh in shell]
    pieces.append(
        PropPiece(LIT, quad([(-0.55, 0.255, 0.31), (0.55, 0.255, 0.31), (0.55, 0.255, 1.71), (-0.55, 0.255, 1.71)]))
    )
    for z in (0.32, 0.68, 1.04, 1.40):
        pieces.append(PropPiece(GREY, block((-0.555, -0.26, z - 0.015), (0.555, 0.24, z))))
        for column in range(9):
            x = -0.49 + 0.1225 * column
            paint = GOODS[int(rng.integers(len(GOODS)))]
            pieces.append(
                PropPiece(paint, uncapped(lathe([(0.04, z), (0.04, z + 0.18), (0.015, z + 0.26)], (x, -0.16), 7)))
            )
    mullion = block((-0.02, -0.318, 0.302), (0.02, -0.28, 1.718))
    return [*pieces, PropPiece(BLACK, mullion)]


def vending_machine(variant: int, rng: Generator) -> list[PropPiece]:
    """A vending machine with a lit window, a keypad and a tray."""
    case = painted(("Red", "Blue", "Charcoal")[variant % 3], 0.4)
    body = cushion((-0.46, -0.36, 0.03), (0.46, 0.40, 1.83), 0.02)
    window = quad([(-0.40, -0.365, 0.62), (0.18, -0.365, 0.62), (0.18, -0.365, 1.74), (-0.40, -0.365, 1.74)])
    pieces = [PropPiece(case, body), PropPiece(glowing("VendingGlow", "#e6eef2", glow=0.6), window)]
    for row in range(5):
        z = 0.66 + 0.215 * row
        for column in range(5):
            x = -0.36 + 0.112 * column
            item = open_block((x, -0.372, z), (x + 0.085, -0.366, z + 0.15), "SEWT")
            pieces.append(PropPiece(GOODS[int(rng.integers(len(GOODS)))], item))
    pad = open_block((0.24, -0.366, 1.05), (0.40, -0.36, 1.45), "SEWBT")
    tray = open_block((-0.36, -0.368, 0.22), (0.16, -0.36, 0.46), "SEWBT")
    foot = block((-0.42, -0.30, 0.0), (0.42, 0.36, 0.03))
    return [*pieces, PropPiece(BLACK, pad), PropPiece(BLACK, tray), PropPiece(BLACK, foot)]


def clothes_rail(variant: int, rng: Generator) -> list[PropPiece]:
    """A rail on two stands with a row of shirts or coats in one colour family."""
    half = (0.60, 0.50, 0.70)[variant % 3]
    stands = [rod((x, 0.0, 0.03), (x, 0.0, 1.45), 0.016, 6) for x in (-half, half)]
    feet = [rod((x, -0.26, 0.02), (x, 0.26, 0.02), 0.018, 5) for x in (-half, half)]
    bar = rod((-half, 0.0, 1.45), (half, 0.0, 1.45), 0.014, 6)
    families = (("Navy", "SkyBlue", "Blue"), ("DarkRed", "Red", "Pink"), ("Green", "Teal", "Beige"))
    family = families[variant % 3]
    pieces = [PropPiece(CHROME, mesh) for mesh in (*stands, *feet, bar)]
    x = -half + 0.12
    while x < half - 0.08:
        low = 1.40 - float(rng.uniform(0.62, 0.85))
        outline = [(-0.20, low), (0.20, low), (0.21, 1.30), (0.05, 1.40), (-0.05, 1.40), (-0.21, 1.30)]
        shirt = loft(np.array([[(x + side, y, z) for y, z in outline] for side in (-0.022, 0.022)]))
        pieces.append(PropPiece(cloth(family[int(rng.integers(3))]), shirt))
        pieces.append(PropPiece(CHROME, rod((x, 0.0, 1.39), (x, 0.0, 1.455), 0.004, 3)))
        x += float(rng.uniform(0.075, 0.12))
    return pieces


def mannequin(variant: int, _rng: Generator) -> list[PropPiece]:
    """A dressed dummy on a round base."""
    skin, top, skirt = (
        (WHITE, cloth("Red"), cloth("Navy")),
        (wood("Pale"), cloth("Green"), cloth("Beige")),
        (GREY, cloth("Blue"), cloth("Black")),
    )[variant % 3]
    base = cylinder(0.20, 0.0, 0.02, sides=16)
    pole = rod((0.0, 0.03, 0.02), (0.0, 0.03, 0.60), 0.014, 5)
    legs = [lathe([(0.045, 0.06), (0.055, 0.40), (0.075, 0.80)], (x, 0.0), 8) for x in (-0.08, 0.08)]
    dress = lathe([(0.20, 0.55), (0.15, 0.90), (0.13, 1.02)], sides=12)
    body = lathe([(0.135, 1.0), (0.16, 1.22), (0.19, 1.38), (0.06, 1.48)], sides=12)
    head = lathe([(0.04, 1.48), (0.05, 1.52), (0.085, 1.60), (0.09, 1.67), (0.05, 1.75), (0.01, 1.765)], sides=10)
    arms = [tube([(x, 0.0, 1.40), (x * 1.3, -0.02, 1.18), (x * 1.22, -0.08, 0.95)], 0.035, 6) for x in (-0.19, 0.19)]
    return [
        PropPiece(CHROME, base),
        PropPiece(CHROME, pole),
        *(PropPiece(skin, mesh) for mesh in (*legs, head)),
        PropPiece(skirt, dress),
        PropPiece(top, body),
        *(PropPiece(top, arm) for arm in arms),
    ]


def shopping_cart(variant: int, _rng: Generator) -> list[PropPiece]:
    """A wire cart with a coloured handle and a child flap."""
    paint = painted(("Red", "Blue", "Green")[variant % 3], 0.4)
    corners = [(-0.22, -0.42), (0.22, -0.42), (0.27, 0.36), (-0.27, 0.36)]
    low = [(x * 0.85, y * 0.9) for x, y in corners]
    wires: list[AuthoredMesh] = []
    for z, ring in (
        (0.55, low),
        (0.72, [((a[0] + b[0]) / 2, (a[1] + b[1]) / 2) for a, b in zip(low, corners, strict=True)]),
        (0.92, corners),
    ):
        for (x0, y0), (x1, y1) in zip(ring, ring[1:] + ring[:1], strict=True):
            wires.append(rod((x0, y0, z), (x1, y1, z), 0.009, 4))
    for (x0, y0), (x1, y1), (u0, v0), (u1, v1) in zip(
        low, low[1:] + low[:1], corners, corners[1:] + corners[:1], strict=True
    ):
        for k in range(6):
            s = k / 6
            wires.append(
                rod(
                    (x0 + s * (x1 - x0), y0 + s * (y1 - y0), 0.55),
                    (u0 + s * (u1 - u0), v0 + s * (v1 - v0), 0.92),
                    0.005,
                    3,
                )
            )
    floor_ = open_block((-0.19, -0.36, 0.545), (0.19, 0.31, 0.555), "SENWBT")
    frame = [tube([(x, 0.34, 0.92), (x, 0.36, 0.14), (x, -0.34, 0.14)], 0.014, 5) for x in (-0.22, 0.22)]
    posts = [rod((x, -0.30, 0.14), (x, -0.36, 0.56), 0.012, 4) for x in (-0.18, 0.18)]
    handle = rod((-0.27, 0.45, 0.98), (0.27, 0.45, 0.98), 0.018, 6)
    grips = [rod((x, 0.36, 0.92), (x, 0.45, 0.98), 0.012, 4) for x in (-0.26, 0.26)]
    wheels = [
        moved(cylinder(0.055, -0.014, 0.014, sides=10), (x, y, 0.055), pitch=1.5708)
        for x in (-0.22, 0.22)
        for y in (-0.32, 0.34)
    ]
    forks = [
        block((x - 0.012, y - 0.012, 0.06), (x + 0.012, y + 0.012, 0.14)) for x in (-0.22, 0.22) for y in (-0.32, 0.34)
    ]
    return [
        *(PropPiece(CHROME, mesh) for mesh in (*wires, *frame, *posts, *grips, *forks, floor_)),
        PropPiece(paint, handle),
        PropPiece(paint, open_block((-0.20, 0.30, 0.75), (0.20, 0.325, 0.90), "SENWBT")),
        *(PropPiece(BLACK, wheel) for wheel in wheels),
    ]


def produce_stand(variant: int, rng: Generator) -> list[PropPiece]:
    """A slanted stand with crates of fruit and vegetables, 1.2 m wide."""
    wooden = wood(("Oak", "Pale", "Walnut")[variant % 3])
    meshes = [block((-0.6, -0.36, 0.0), (0.6, 0.36, 0.42)), block((-0.6, 0.0, 0.42), (0.6, 0.36, 0.72))]
    pieces: list[PropPiece] = []
    for y, z in ((-0.19, 0.42), (0.18, 0.72)):
        for x in (-0.39, 0.0, 0.39):
            meshes += [
                block((x - 0.185, y - 0.165, z), (x + 0.185, y - 0.15, z + 0.12)),
                block((x - 0.185, y + 0.15, z), (x + 0.185, y + 0.165, z + 0.12)),
                *(block((u - 0.008, y - 0.15, z), (u + 0.008, y + 0.15, z + 0.12)) for u in (x - 0.177, x + 0.177)),
            ]
            fruit = painted(("Red", "Orange", "Green", "Yellow", "Purple", "Leaf")[int(rng.integers(6))], 0.4)
            for row in range(3):
                for column in range(3):
                    at = (x - 0.11 + 0.11 * column, y - 0.09 + 0.09 * row)
                    ball = lathe([(0.02, z + 0.05), (0.055, z + 0.10), (0.02, z + 0.155)], at, 6)
                    pieces.append(PropPiece(fruit, ball))
    return [*(PropPiece(wooden, mesh) for mesh in meshes), *pieces]


def step_ladder(variant: int, _rng: Generator) -> list[PropPiece]:
    """A folding ladder with four to six treads."""
    treads = (4, 6, 5)[variant % 3]
    paint = painted(("Yellow", "Steel", "Orange")[variant % 3], 0.4)
    high = 0.26 * treads
    rails = [rod((x, -0.30, 0.0), (x * 0.75, 0.0, high + 0.02), 0.02, 4) for x in (-0.25, 0.25)]
    backs = [rod((x, 0.34, 0.0), (x * 0.75, 0.03, high), 0.016, 4) for x in (-0.23, 0.23)]
    steps = []
    for step in range(1, treads + 1):
        s = step / treads
        half, y = 0.25 - 0.06 * s, -0.30 + 0.30 * s
        steps.append(block((-half, y - 0.06, 0.26 * step - 0.02), (half, y + 0.06, 0.26 * step)))
    tie = rod((-0.215, 0.2, high * 0.42), (0.215, 0.2, high * 0.42), 0.012, 4)
    return [*(PropPiece(paint, mesh) for mesh in (*rails, *backs, tie)), *(PropPiece(BLACK, step) for step in steps)]


def moving_box(variant: int, _rng: Generator) -> list[PropPiece]:
    """One carton on the floor."""
    half_x, half_y, high = ((0.28, 0.20, 0.36), (0.22, 0.22, 0.42), (0.34, 0.24, 0.30))[variant % 3]
    look = (CARTONS[0], CARTONS[2], CARTONS[3])[variant % 3]
    return [PropPiece(look, fitted_block((-half_x, -half_y, 0.0), (half_x, half_y, high)))]


def offer_sign(variant: int, _rng: Generator) -> list[PropPiece]:
    """A framed advertising poster on the wall, at a height of 1.45 to 2.17 m; the wall plane is y = 0."""
    name = ("PosterOffer", "PosterSun", "PosterBlocks")[variant % 3]
    border = block((-0.36, -0.03, 1.45), (0.36, 0.0, 2.17))
    art = quad([(-0.33, -0.032, 1.48), (0.33, -0.032, 1.48), (0.33, -0.032, 2.14), (-0.33, -0.032, 2.14)])
    return [PropPiece(WHITE, border), PropPiece(SurfaceMaterial(name, "#dcd2c0", name, roughness=0.4), art)]
