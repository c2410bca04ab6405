"""Builders of hospital furniture that is not a target: beds, night stands, infusion stands, curtains, trolleys, a
wheelchair.

Lengths in metres, origin on the floor, head end at +y. Does not place props.
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
    loft,
    moved,
    open_block,
    pad,
    rod,
    tube,
    uncapped,
)
from factory.scenes.author.materials import PropPiece, glowing, painted, textured

WHITE = painted("White", 0.45)
BLACK = painted("Black", 0.5)
STEEL = painted("Steel", 0.35, 1.0)
CHROME = painted("Chrome", 0.25, 1.0)
PALE = textured("WoodPale", "#d9c19a", 0.8)


def bed(variant: int, rng: Generator) -> list[PropPiece]:
    """A hospital bed on castors: mattress, blanket, pillow, head and foot boards, side rails."""
    blanket = painted(("SkyBlue", "Teal", "Beige")[variant % 3], 0.95)
    tilt = 0.12 + 0.18 * float(rng.random())
    frame = block((-0.44, -0.98, 0.36), (0.44, 0.98, 0.42))
    mattress = pad((-0.43, -0.95, 0.42), (0.43, 0.35, 0.58), 0.03)
    raised = moved(pad((-0.43, 0.0, -0.16), (0.43, 0.66, 0.0), 0.03), (0.0, 0.33, 0.58), roll=tilt)
    cover = pad((-0.455, -0.96, 0.44), (0.455, 0.10, 0.605), 0.03)
    pillow = moved(
        pad((-0.27, -0.17, 0.0), (0.27, 0.17, 0.12), 0.05, is_loose=True), (0.0, 0.68, 0.59 + 0.35 * tilt), roll=tilt
    )
    ends = [_end_board(y, z) for y, z in ((1.0, 1.02), (-1.0, 0.86))]
    legs = [
        block((x - 0.025, y - 0.025, 0.1), (x + 0.025, y + 0.025, 0.36)) for x in (-0.36, 0.36) for y in (-0.8, 0.8)
    ]
    base = block((-0.36, -0.8, 0.14), (0.36, 0.8, 0.19))
    wheels = [
        moved(cylinder(0.055, -0.02, 0.02, sides=6), (x, y, 0.055), pitch=1.5708)
        for x in (-0.36, 0.36)
        for y in (-0.8, 0.8)
    ]
    rails = [
        tube([(x, 0.15, 0.45), (x, 0.2, 0.8), (x, 0.75, 0.8), (x, 0.8, 0.45)], 0.016, 4) for x in (-0.465, 0.465)
    ] + [rod((x, 0.18, 0.64), (x, 0.78, 0.64), 0.010, 3) for x in (-0.465, 0.465)]
    pieces = [PropPiece(WHITE, m) for m in (frame, mattress, raised, pillow)] + [PropPiece(PALE, m) for m in ends]
    return [
        *pieces,
        PropPiece(blanket, cover),
        *(PropPiece(STEEL, m) for m in (*legs, base, *rails)),
        *(PropPiece(BLACK, m) for m in wheels),
    ]


def _end_board(y: float, top: float) -> AuthoredMesh:
    """A board across the bed with rounded upper corners, 4 cm thick."""
    outline = [(-0.46, 0.30), (0.46, 0.30), (0.46, top - 0.06), (0.40, top), (-0.40, top), (-0.46, top - 0.06)]
    return loft(np.array([[(x, side, z) for x, z in outline] for side in (y + 0.02, y - 0.02)]))


def nightstand(_variant: int, rng: Generator) -> list[PropPiece]:
    """A bedside unit with two drawers, a cup and a lamp."""
    body = open_block((-0.22, -0.2, 0.08), (0.22, 0.2, 0.72), "SENWB")
    fronts = [open_block((-0.2, -0.215, z), (0.2, -0.2, z + 0.26), "SEWBT") for z in (0.12, 0.42)]
    feet = [uncapped(cylinder(0.025, 0.0, 0.08, (x, y), 4)) for x in (-0.17, 0.17) for y in (-0.15, 0.15)]
    top = block((-0.24, -0.22, 0.72), (0.24, 0.22, 0.75))
    cup = cylinder(0.035, 0.75, 0.85, (0.1, -0.05), 8)
    return [PropPiece(WHITE, body), *(PropPiece(PALE, m) for m in (*fronts, top)), *(PropPiece(BLACK, m) for m in feet),
            PropPiece(painted(("SkyBlue", "Orange")[int(rng.integers(2))]), cup)]  # fmt: skip


def drip_stand(_variant: int, _rng: Generator) -> list[PropPiece]:
    """An infusion stand on five castors with a bag."""
    pole = rod((0.0, 0.0, 0.1), (0.0, 0.0, 1.95), 0.014)
    feet = [
        tube([(0, 0, 0.12), (0.22 * x, 0.22 * y, 0.05)], 0.013, 4)
        for x, y in ((1, 0), (0.31, 0.95), (-0.81, 0.59), (-0.81, -0.59), (0.31, -0.95))
    ]
    arm = rod((-0.14, 0.0, 1.95), (0.14, 0.0, 1.95), 0.01)
    bag = pad((-0.20, -0.03, 1.62), (-0.08, 0.03, 1.88), 0.015, is_loose=True)
    unit = pad((-0.09, -0.12, 1.05), (0.09, -0.01, 1.3), 0.02, is_loose=True)
    return [
        *(PropPiece(CHROME, m) for m in (pole, arm, *feet)),
        PropPiece(painted("SkyBlue", 0.2), bag),
        PropPiece(WHITE, unit),
    ]


def curtain(variant: int, _rng: Generator) -> list[PropPiece]:
    """A privacy curtain drawn together into folds, hanging from 2.2 m to just above the floor, 0.5 m long in y."""
    paint = painted(("Teal", "SkyBlue", "Beige")[variant % 3], 0.95)
    folds = [(0.05 if step % 2 else 0.015, 0.05 * step - 0.25) for step in range(11)]
    outline = [(x, y) for x, y in folds] + [(-x, y) for x, y in reversed(folds)]
    rings = np.array([[(x, y, z) for x, y in outline] for z in (0.08, 2.2)])
    return [PropPiece(paint, loft(rings))]


def head_panel(_variant: int, _rng: Generator) -> list[PropPiece]:
    """The service panel above the head of a bed: rail, sockets and a reading light."""
    board = block((-0.75, 0.0, 1.25), (0.75, 0.06, 1.5))
    light = block((-0.4, -0.04, 1.55), (0.4, 0.06, 1.62))
    sockets = [block((x - 0.04, -0.01, 1.3), (x + 0.04, 0.0, 1.4)) for x in (-0.5, -0.3, 0.3, 0.5)]
    paint = (painted("Green"), painted("Blue"), painted("Yellow"), painted("Red"))
    return [
        PropPiece(PALE, board),
        PropPiece(glowing("LampPanel", "#fffdf4"), light),
        *(PropPiece(p, m) for p, m in zip(paint, sockets, strict=True)),
    ]


def trolley(variant: int, _rng: Generator) -> list[PropPiece]:
    """A medicine trolley with coloured drawers on castors."""
    body = block((-0.3, -0.22, 0.14), (0.3, 0.22, 0.92))
    paint = painted(("Red", "Blue", "Teal")[variant % 3])
    drawers = [block((-0.28, -0.235, 0.18 + row * 0.18), (0.28, -0.22, 0.34 + row * 0.18)) for row in range(4)]
    wheels = [
        moved(cylinder(0.06, -0.02, 0.02, sides=8), (x, y, 0.06), pitch=1.5708)
        for x in (-0.24, 0.24)
        for y in (-0.16, 0.16)
    ]
    top = cushion((-0.32, -0.24, 0.92), (0.32, 0.24, 0.96), 0.01)
    jar = fitted_block((-0.2, -0.1, 0.96), (0.0, 0.1, 1.08))
    return [PropPiece(WHITE, body), *(PropPiece(paint, m) for m in drawers), *(PropPiece(BLACK, m) for m in wheels),
            PropPiece(STEEL, top), PropPiece(painted("Beige"), jar)]  # fmt: skip


def wheelchair(variant: int, _rng: Generator) -> list[PropPiece]:
    """A wheelchair: two large wheels, castors, seat and back of dark cloth."""
    cloth = painted(("Navy", "Black")[variant % 2], 0.9)
    turns = [step * 2 * math.pi / 14 for step in range(15)]
    ring = tube([(0.28 * math.cos(turn), 0.28 * math.sin(turn), 0.0) for turn in turns], 0.018, 4)
    hub = cylinder(0.03, -0.02, 0.02, sides=8)
    pieces: list[PropPiece] = []
    for x in (-0.29, 0.29):
        place = (x, 0.12, 0.30)
        pieces.append(PropPiece(BLACK, moved(ring, place, pitch=1.5708)))
        pieces.append(PropPiece(CHROME, moved(hub, place, pitch=1.5708)))
        for spoke in ((0.0, 0.27), (0.23, -0.13), (-0.23, -0.13)):
            pieces.append(PropPiece(CHROME, rod(place, (x, 0.12 + spoke[0], 0.30 + spoke[1]), 0.006, 4)))
        pieces.append(
            PropPiece(BLACK, moved(cylinder(0.08, -0.015, 0.015, sides=10), (x * 0.85, -0.36, 0.08), pitch=1.5708))
        )
        frame = [
            (x * 0.85, 0.22, 0.9),
            (x * 0.85, 0.16, 0.48),
            (x * 0.85, -0.26, 0.48),
            (x * 0.85, -0.4, 0.14),
            (x * 0.85, -0.52, 0.12),
        ]
        pieces.append(PropPiece(CHROME, tube(frame, 0.013, 5)))
        pieces.append(PropPiece(BLACK, block((x * 0.85 - 0.02, -0.2, 0.66), (x * 0.85 + 0.02, 0.12, 0.69))))
    pieces.append(PropPiece(cloth, block((-0.23, -0.26, 0.47), (0.23, 0.16, 0.50))))
    pieces.append(
        PropPiece(cloth, moved(block((-0.23, -0.01, 0.0), (0.23, 0.015, 0.4)), (0.0, 0.165, 0.5), roll=-0.12))
    )
    return pieces


def wash_unit(_variant: int, _rng: Generator) -> list[PropPiece]:
    """A hand basin on a cupboard with tap, mirror, tiles and a soap dispenser."""
    cupboard = block((-0.3, -0.2, 0.12), (0.3, 0.22, 0.78))
    doors = [block((x - 0.14, -0.215, 0.16), (x + 0.14, -0.2, 0.74)) for x in (-0.145, 0.145)]
    basin = pad((-0.33, -0.24, 0.78), (0.33, 0.22, 0.88), 0.03)
    tap = tube([(0.0, 0.17, 0.88), (0.0, 0.17, 1.05), (0.0, 0.05, 1.06), (0.0, 0.02, 1.01)], 0.014)
    tiles = block((-0.45, 0.205, 0.9), (0.45, 0.22, 1.6))
    mirror = block((-0.22, 0.195, 1.1), (0.22, 0.205, 1.55))
    soap = block((0.3, 0.12, 1.1), (0.4, 0.205, 1.35))
    foot = block((-0.27, -0.15, 0.0), (0.27, 0.22, 0.12))
    wall = textured("TileWall", "#e3e6e4", 1.0, 0.3)
    return [PropPiece(PALE, cupboard), *(PropPiece(WHITE, m) for m in (*doors, basin, soap)), PropPiece(CHROME, tap),
            PropPiece(wall, tiles), PropPiece(painted("SkyBlue", 0.1), mirror), PropPiece(BLACK, foot)]  # fmt: skip
