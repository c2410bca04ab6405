"""Builders of furniture with doors and drawers: a table of sizes, fronts and finishes for each kind.

Lengths in metres, origin on the floor, front facing -y. Does not place props.
"""

from __future__ import annotations

from typing import NamedTuple

from numpy.random import Generator

from factory.scenes.author.geometry import AuthoredMesh, block, cylinder, fitted_block, open_block
from factory.scenes.author.materials import PropPiece, SurfaceMaterial, painted, wood

WHITE = painted("White", 0.45)
STEEL = painted("Steel", 0.35, 1.0)
BLACK = painted("Black", 0.5)
GREY = painted("LightGrey", 0.5)
SPINES = tuple(
    SurfaceMaterial(name, "#5a4a44", name) for name in ("BookSpines", "SpinesPale", "SpinesLeather", "SpinesBright")
)
FRONT_M = 0.018


class CupboardModel(NamedTuple):
    """Model of a cupboard: width, depth and height, metres; rows and columns of fronts; finishes."""

    size: tuple[float, float, float]
    rows: int
    columns: int
    body: SurfaceMaterial
    front: SurfaceMaterial
    foot_m: float = 0.06
    grip: SurfaceMaterial = STEEL


NIGHTSTANDS = (
    CupboardModel((0.45, 0.40, 0.52), 2, columns=1, body=wood("Oak"), front=wood("Oak"), foot_m=0.12, grip=BLACK),
    CupboardModel((0.42, 0.38, 0.55), 2, columns=1, body=WHITE, front=WHITE, foot_m=0.06),
    CupboardModel((0.50, 0.40, 0.48), 1, columns=1, body=wood("Walnut"), front=wood("Walnut"), foot_m=0.18),
    CupboardModel(
        (0.44, 0.38, 0.54), 3, columns=1, body=painted("SkyBlue", 0.5), front=painted("SkyBlue", 0.5), foot_m=0.05
    ),
)
DRESSERS = (
    CupboardModel((1.20, 0.46, 0.80), 3, columns=2, body=wood("Oak"), front=wood("Oak"), foot_m=0.10, grip=BLACK),
    CupboardModel((0.90, 0.45, 1.05), 4, columns=1, body=WHITE, front=WHITE, foot_m=0.06),
    CupboardModel((1.30, 0.45, 0.76), 3, columns=3, body=wood("Walnut"), front=wood("Walnut"), foot_m=0.12),
    CupboardModel(
        (1.00, 0.45, 0.90), 4, columns=2, body=painted("Green", 0.5), front=painted("Green", 0.5), foot_m=0.08
    ),
)
WARDROBES = (
    CupboardModel((1.20, 0.58, 2.05), 1, columns=2, body=wood("Oak"), front=wood("Oak"), foot_m=0.08, grip=BLACK),
    CupboardModel((1.50, 0.60, 2.15), 1, columns=3, body=WHITE, front=WHITE, foot_m=0.06),
    CupboardModel((1.00, 0.58, 1.95), 1, columns=2, body=wood("Walnut"), front=wood("Walnut"), foot_m=0.10),
    CupboardModel((1.60, 0.60, 2.10), 1, columns=4, body=wood("Ash"), front=wood("Ash"), foot_m=0.06, grip=BLACK),
)
SIDEBOARDS = (
    CupboardModel((1.50, 0.45, 0.78), 1, columns=3, body=wood("Oak"), front=wood("Oak"), foot_m=0.14, grip=BLACK),
    CupboardModel((1.40, 0.42, 0.80), 2, columns=2, body=WHITE, front=WHITE, foot_m=0.10),
    CupboardModel((1.60, 0.45, 0.74), 1, columns=4, body=wood("Walnut"), front=wood("Walnut"), foot_m=0.16),
    CupboardModel(
        (1.20, 0.42, 0.90), 2, columns=2, body=painted("Green", 0.5), front=painted("Green", 0.5), foot_m=0.10
    ),
)
MEDIA_BENCHES = (
    CupboardModel((1.50, 0.40, 0.46), 1, columns=3, body=wood("Oak"), front=wood("Oak"), foot_m=0.10, grip=BLACK),
    CupboardModel((1.60, 0.42, 0.42), 1, columns=2, body=WHITE, front=WHITE, foot_m=0.06),
    CupboardModel((1.40, 0.40, 0.48), 2, columns=2, body=wood("Walnut"), front=wood("Walnut"), foot_m=0.12),
    CupboardModel(
        (1.70, 0.42, 0.40), 1, columns=4, body=painted("Black", 0.5), front=painted("Black", 0.5), foot_m=0.05
    ),
)
LOCKERS = tuple(
    CupboardModel((0.90, 0.45, 1.85), rows, columns=3, body=GREY, front=painted(paint, 0.45), foot_m=0.10)
    for rows, paint in ((1, "Blue"), (2, "Red"), (2, "Green"), (1, "Yellow"))
)


def carcass(model: CupboardModel) -> list[PropPiece]:
    """A body on a plinth or feet with a grid of fronts; each front has a grip."""
    width, depth, height = model.size
    half, back = width / 2, depth / 2
    front = -back + FRONT_M
    body = block((-half, front, model.foot_m), (half, back, height))
    feet = [
        block((x - 0.03, y - 0.03, 0.0), (x + 0.03, y + 0.03, model.foot_m))
        for x in (-half + 0.06, half - 0.06)
        for y in (front + 0.06, back - 0.06)
    ]
    fronts, grips = [], []
    across, up = width / model.columns, (height - model.foot_m) / model.rows
    for column in range(model.columns):
        for row in range(model.rows):
            x0, z0 = -half + column * across, model.foot_m + row * up
            fronts.append(
                open_block((x0 + 0.006, -back, z0 + 0.006), (x0 + across - 0.006, front, z0 + up - 0.006), "SEWBT")
            )
            grips.append(_grip(model, x0, z0=z0, across=across, up=up, column=column))
    return [
        PropPiece(model.body, body),
        *(PropPiece(model.body, mesh) for mesh in feet),
        *(PropPiece(model.front, mesh) for mesh in fronts),
        *(PropPiece(model.grip, mesh) for mesh in grips),
    ]


def _grip(model: CupboardModel, x0: float, z0: float, across: float, up: float, column: int) -> AuthoredMesh:
    """A bar handle: horizontal on a drawer, vertical at the opening edge of a door."""
    face = -model.size[1] / 2
    if up < 1.1 * across:
        x, z = x0 + across / 2, z0 + 0.72 * up
        return open_block((x - 0.07, face - 0.022, z - 0.007), (x + 0.07, face, z + 0.007), "SEWBT")
    x = x0 + (0.06 if column % 2 else across - 0.06)
    z = z0 + min(0.55 * up, 1.0)
    return open_block((x - 0.007, face - 0.022, z - 0.08), (x + 0.007, face, z + 0.08), "SEWBT")


def nightstand(variant: int, rng: Generator) -> list[PropPiece]:
    """A bedside unit with a book or a cup."""
    model = NIGHTSTANDS[variant % len(NIGHTSTANDS)]
    top = model.size[2]
    if rng.random() < 0.5:
        thing = cylinder(0.04, top, top + 0.09, (0.1, -0.05), 10)
    else:
        thing = block((0.02, -0.12, top), (0.16, 0.08, top + 0.03))
    return [*carcass(model), PropPiece(painted(("Orange", "SkyBlue", "Red")[int(rng.integers(3))]), thing)]


def dresser(variant: int, _rng: Generator) -> list[PropPiece]:
    """A chest of drawers."""
    return carcass(DRESSERS[variant % len(DRESSERS)])


def wardrobe(variant: int, _rng: Generator) -> list[PropPiece]:
    """A wardrobe with two to four doors."""
    return carcass(WARDROBES[variant % len(WARDROBES)])


def sideboard(variant: int, _rng: Generator) -> list[PropPiece]:
    """A low cabinet."""
    return carcass(SIDEBOARDS[variant % len(SIDEBOARDS)])


def media_bench(variant: int, _rng: Generator) -> list[PropPiece]:
    """A low cabinet below a television."""
    return carcass(MEDIA_BENCHES[variant % len(MEDIA_BENCHES)])


def locker(variant: int, _rng: Generator) -> list[PropPiece]:
    """Three columns of steel lockers."""
    return carcass(LOCKERS[variant % len(LOCKERS)])


def _ornament(kind: int, x: float, z: float, room: float) -> PropPiece:
    """A pot, a box, a bowl or a jar in a gap between books."""
    high = min(room, (0.13, 0.18, 0.07, 0.16)[kind])
    if kind == 1:
        return PropPiece(painted("Beige", 0.8), block((x - 0.09, -0.10, z), (x + 0.09, 0.10, z + high)))
    paint = ("Terracotta", "Beige", "SkyBlue", "Teal")[kind]
    return PropPiece(painted(paint, 0.5), cylinder(0.05, z, z + high, (x, 0.0), 8, top=(0.06, 0.05, 0.09, 0.03)[kind]))


def bookcase(variant: int, rng: Generator) -> list[PropPiece]:
    """An open case with rows of books of one kind; baskets or pots in the gaps."""
    finish = (wood("Oak"), WHITE, wood("Walnut"), wood("Ebony"))[variant % 4]
    half, height, rows = ((0.45, 1.9, 5), (0.60, 1.5, 4), (0.40, 2.0, 6), (0.50, 1.2, 3))[variant % 4]
    step = (height - 0.08) / rows
    boards = [block((x - 0.015, -0.15, 0.0), (x + 0.015, 0.15, height)) for x in (-half + 0.015, half - 0.015)]
    boards.append(block((-half + 0.03, 0.135, 0.0), (half - 0.03, 0.148, height - 0.002)))
    pieces = []
    for row in range(rows + 1):
        z = 0.06 + row * step - (0.002 if row == rows else 0.0)
        boards.append(block((-half + 0.03, -0.147, z - 0.02), (half - 0.03, 0.135, z)))
        if row < rows:
            gap = float(rng.uniform(0.0, 0.6)) * half
            books = fitted_block((-half + 0.04, -0.11, z), (half - 0.04 - gap, 0.12, z + 0.72 * step))
            pieces.append(PropPiece(SPINES[variant // 3 % 4], books))
            if gap > 0.2:
                pieces.append(_ornament((variant + row) % 4, half - 0.13, z, 0.72 * step))
    return [*(PropPiece(finish, mesh) for mesh in boards), *pieces]
