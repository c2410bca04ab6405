"""Builders for schools: pupils' desks, lecterns, computers, laptops, printers, bicycles, cones, clocks, coolers.

Lengths in metres, origin on the floor, front facing -y. Does not place props.
"""

from __future__ import annotations

import math

from numpy.random import Generator

from factory.scenes.author.geometry import (
    block,
    cushion,
    cylinder,
    lathe,
    moved,
    open_block,
    quad,
    rod,
    tube,
    uncapped,
)
from factory.scenes.author.materials import PropPiece, SurfaceMaterial, glowing, painted, wood

WHITE = painted("White", 0.45)
BLACK = painted("Black", 0.5)
STEEL = painted("Steel", 0.35, 1.0)
CHROME = painted("Chrome", 0.25, 1.0)
GREY = painted("LightGrey", 0.5)


def pupil_desk(variant: int, _rng: Generator) -> list[PropPiece]:
    """A desk for two pupils on a steel frame, with a book."""
    top = block((-0.60, -0.26, 0.69), (0.60, 0.26, 0.72))
    finish = (wood("Pale"), wood("Oak"), WHITE)[variant % 3]
    frame = painted(("Blue", "Green", "Red", "Grey")[variant % 4], 0.45)
    legs = [rod((x, y, 0.0), (x, y, 0.69), 0.018, 6) for x in (-0.53, 0.53) for y in (-0.21, 0.21)]
    bars = [rod((x, -0.21, 0.08), (x, 0.21, 0.08), 0.014, 5) for x in (-0.53, 0.53)]
    bars.append(rod((-0.53, 0.21, 0.50), (0.53, 0.21, 0.50), 0.014, 5))
    book = open_block((-0.38, -0.16, 0.72), (-0.20, 0.06, 0.74), "SENWT")
    cover = painted(("Red", "SkyBlue", "Yellow")[variant % 3], 0.5)
    return [PropPiece(finish, top), *(PropPiece(frame, mesh) for mesh in (*legs, *bars)), PropPiece(cover, book)]


def lectern(variant: int, _rng: Generator) -> list[PropPiece]:
    """A teacher's counter 1.4 m wide with drawers."""
    finish = wood(("Oak", "Walnut", "Ash")[variant % 3])
    front = block((-0.70, 0.24, 0.05), (0.70, 0.27, 0.72))
    top = block((-0.74, -0.36, 0.72), (0.74, 0.32, 0.76))
    sides = [block((x - 0.02, -0.30, 0.0), (x + 0.02, 0.27, 0.72)) for x in (-0.72, 0.72)]
    chest = block((0.28, -0.30, 0.10), (0.70, 0.24, 0.72))
    grips = [open_block((0.42, -0.322, z), (0.56, -0.30, z + 0.014), "SEWBT") for z in (0.25, 0.45, 0.64)]
    return [
        *(PropPiece(finish, mesh) for mesh in (front, top, *sides, chest)),
        *(PropPiece(STEEL, grip) for grip in grips),
    ]


def laptop(variant: int, _rng: Generator) -> list[PropPiece]:
    """An open laptop; its foot is at z = 0."""
    case = painted(("Steel", "Black", "Red")[variant % 3], 0.4)
    name = ("ScreenDesktop", "ScreenCode", "ScreenChart")[variant % 3]
    deck = block((-0.17, -0.12, 0.0), (0.17, 0.12, 0.018))
    keys = open_block((-0.15, -0.03, 0.018), (0.15, 0.10, 0.021), "SENWT")
    lid = moved(block((-0.17, 0.0, 0.0), (0.17, 0.012, 0.23)), (0.0, 0.11, 0.016), roll=-0.3)
    screen = moved(
        quad([(-0.155, -0.003, 0.015), (0.155, -0.003, 0.015), (0.155, -0.003, 0.215), (-0.155, -0.003, 0.215)]),
        (0.0, 0.11, 0.016),
        roll=-0.3,
    )
    return [
        PropPiece(case, deck),
        PropPiece(painted("Charcoal"), keys),
        PropPiece(case, lid),
        PropPiece(glowing(name, "#6aa3dc", name, 0.85), screen),
    ]


def computer_case(variant: int, _rng: Generator) -> list[PropPiece]:
    """A desktop computer on the floor: tower with drive, button and lit ring."""
    case = painted(("Black", "White", "LightGrey")[variant % 3], 0.4)
    half, high = ((0.10, 0.44), (0.09, 0.40), (0.11, 0.48))[variant % 3]
    body = cushion((-half, -0.22, 0.02), (half, 0.22, high), 0.01)
    drive = open_block((-half + 0.02, -0.225, high - 0.10), (half - 0.02, -0.22, high - 0.06), "SEWBT")
    ring = moved(cylinder(0.015, 0.0, 0.006, sides=10), (0.0, -0.22, high - 0.16), roll=1.5708)
    feet = [
        block((x - 0.02, y - 0.02, 0.0), (x + 0.02, y + 0.02, 0.02))
        for x in (-half + 0.03, half - 0.03)
        for y in (-0.17, 0.17)
    ]
    return [
        PropPiece(case, body),
        PropPiece(painted("Grey"), drive),
        PropPiece(glowing("PanelLit", "#5fb4e6", glow=0.8), ring),
        *(PropPiece(BLACK, foot) for foot in feet),
    ]


def copier(variant: int, _rng: Generator) -> list[PropPiece]:
    """A copier with trays, a lid and a panel: light, dark or white, 0.9 to 1.1 m high."""
    case = (GREY, painted("Charcoal"), WHITE)[variant % 3]
    high = (0.92, 1.00, 0.84)[variant % 3]
    body = block((-0.28, -0.28, 0.05), (0.28, 0.28, high))
    trays = [
        open_block((-0.26, -0.295, 0.10 + row * 0.17), (0.26, -0.28, 0.25 + row * 0.17), "SEWBT") for row in range(3)
    ]
    lid = cushion((-0.29, -0.20, high), (0.29, 0.29, high + 0.10), 0.02)
    panel = open_block((-0.12, -0.275, high), (0.14, -0.205, high + 0.03), "SENWT")
    foot = block((-0.25, -0.25, 0.0), (0.25, 0.25, 0.05))
    return [
        PropPiece(case, body),
        *(PropPiece(WHITE if variant % 3 < 2 else GREY, tray) for tray in trays),
        PropPiece(case, lid),
        PropPiece(painted("SkyBlue", 0.3), panel),
        PropPiece(BLACK, foot),
    ]


def bicycle(variant: int, _rng: Generator) -> list[PropPiece]:
    """A city bicycle along x, upright on its stand."""
    paint = painted(("Red", "Blue", "Green")[variant % 3], 0.35)
    turns = [step * 2 * math.pi / 16 for step in range(17)]
    ring = tube([(0.33 * math.cos(t), 0.0, 0.33 * math.sin(t)) for t in turns], 0.018, 5)
    pieces: list[PropPiece] = []
    for x in (-0.52, 0.52):
        pieces.append(PropPiece(BLACK, moved(ring, (x, 0.0, 0.35))))
        for t in turns[:-1:2]:
            pieces.append(
                PropPiece(
                    CHROME, rod((x, 0.0, 0.35), (x + 0.32 * math.cos(t), 0.0, 0.35 + 0.32 * math.sin(t)), 0.003, 3)
                )
            )
    crank, saddle, head = (-0.05, 0.0, 0.32), (-0.18, 0.0, 0.82), (0.36, 0.0, 0.80)
    bars = [
        (crank, saddle),
        (crank, head),
        (saddle, head),
        (crank, (-0.52, 0.0, 0.35)),
        (saddle, (-0.52, 0.0, 0.35)),
        (head, (0.52, 0.0, 0.35)),
    ]
    pieces += [PropPiece(paint, rod(a, b, 0.018, 6)) for a, b in bars]
    handle = tube(
        [(0.28, -0.26, 1.00), (0.36, -0.20, 1.02), (0.34, 0.0, 1.00), (0.36, 0.20, 1.02), (0.28, 0.26, 1.00)], 0.013, 5
    )
    parts = [
        handle,
        cushion((-0.32, -0.08, 0.88), (-0.06, 0.08, 0.94), 0.02),
        rod((-0.18, 0.0, 0.80), (-0.19, 0.0, 0.89), 0.013, 5),
        rod((0.36, 0.0, 0.79), (0.34, 0.0, 1.0), 0.014, 5),
        rod((-0.45, 0.02, 0.33), (-0.42, 0.18, 0.0), 0.010, 4),
        moved(cylinder(0.09, -0.008, 0.008, sides=12), crank, roll=1.5708),
    ]
    pieces += [PropPiece(BLACK, mesh) for mesh in parts]
    if variant % 3 == 1:
        carrier = [rod((-0.75, y, 0.72), (-0.25, y, 0.72), 0.008, 4) for y in (-0.07, 0.0, 0.07)]
        pieces += [PropPiece(CHROME, mesh) for mesh in carrier]
    return pieces


def traffic_cone(variant: int, _rng: Generator) -> list[PropPiece]:
    """A cone with a white band: orange, red or yellow; 0.45 to 0.7 m high."""
    paint = painted(("Orange", "Red", "Yellow")[variant % 3])
    high = (0.55, 0.70, 0.45)[variant % 3]
    body = cylinder(0.13, 0.03, high, sides=14, top=0.025)
    at = (0.35, 0.58)
    radii = [0.003 + 0.13 - 0.105 * (high * s - 0.03) / (high - 0.03) for s in at]
    band = uncapped(cylinder(radii[0], high * at[0], high * at[1], sides=14, top=radii[1]))
    return [
        PropPiece(paint, body),
        PropPiece(WHITE, band),
        PropPiece(BLACK, block((-0.17, -0.17, 0.0), (0.17, 0.17, 0.03))),
    ]


def water_dispenser(variant: int, _rng: Generator) -> list[PropPiece]:
    """A water dispenser with a bottle: white, black or grey."""
    case = (WHITE, BLACK, GREY)[variant % 3]
    body = cushion((-0.16, -0.16, 0.0), (0.16, 0.16, (0.98, 1.02, 0.92)[variant % 3]), 0.02)
    top = float(body.points[:, 2].max())
    niche = open_block((-0.10, -0.166, 0.60), (0.10, -0.16, 0.83), "SEWBT")
    taps = [block((x - 0.014, -0.19, 0.76), (x + 0.014, -0.167, 0.80)) for x in (-0.05, 0.05)]
    bottle = lathe(
        [
            (0.05, top - 0.01),
            (0.13, top + 0.07),
            (0.135, top + 0.23),
            (0.125, top + 0.25),
            (0.13, top + 0.38),
            (0.02, top + 0.40),
        ],
        sides=14,
    )
    return [
        PropPiece(case, body),
        PropPiece(painted("Charcoal"), niche),
        PropPiece(painted("Red"), taps[0]),
        PropPiece(painted("Blue"), taps[1]),
        PropPiece(painted("SkyBlue", 0.2), bottle),
    ]


def wall_clock(variant: int, _rng: Generator) -> list[PropPiece]:
    """A round clock on the wall, rim black, red or wooden; the wall plane is y = 0 and its centre 1.75 m high."""
    rim_look = (BLACK, painted("Red", 0.4), wood("Oak"))[variant % 3]
    rim = moved(cylinder(0.17, 0.0, 0.035, sides=20), (0.0, 0.0, 1.75), roll=1.5708)
    face = moved(cylinder(0.15, 0.0, 0.04, sides=20), (0.0, 0.0, 1.75), roll=1.5708)
    hands = [
        open_block((-0.006, -0.045, 1.75), (0.006, -0.041, 1.86), "SEWBT"),
        open_block((0.0, -0.045, 1.744), (0.08, -0.041, 1.756), "SEWBT"),
    ]
    return [PropPiece(rim_look, rim), PropPiece(WHITE, face), *(PropPiece(BLACK, hand) for hand in hands)]


def wall_map(variant: int, _rng: Generator) -> list[PropPiece]:
    """A map or a poster of a school at eye height; the wall plane is y = 0."""
    name = ("PosterWorld", "PosterType", "PosterHills")[variant % 3]
    half = (0.75, 0.40, 0.45)[variant % 3]
    low, high = 1.15, 1.15 + (1.0, 0.9, 0.9)[variant % 3]
    border = block((-half - 0.02, -0.02, low - 0.02), (half + 0.02, 0.0, high + 0.02))
    art = quad([(-half, -0.023, low), (half, -0.023, low), (half, -0.023, high), (-half, -0.023, high)])
    return [
        PropPiece((BLACK, WHITE, wood("Oak"))[variant % 3], border),
        PropPiece(SurfaceMaterial(name, "#dcd2c0", name, roughness=0.5), art),
    ]
