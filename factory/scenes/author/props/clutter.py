"""Builders of furniture and clutter that is not a target: cabinets, counters, lamps, pallets, cones, a pallet truck.

Lengths in metres, origin on the floor, front facing -y. Does not place props.
"""

from __future__ import annotations

from numpy.random import Generator

from factory.scenes.author.geometry import (
    AuthoredMesh,
    block,
    cushion,
    cylinder,
    fitted_block,
    lathe,
    moved,
    quad,
    rod,
    tube,
    uncapped,
)
from factory.scenes.author.materials import PropPiece, SurfaceMaterial, glowing, painted, textured
from factory.scenes.author.props.storage import CARTON, CARTONS, ROUGH, carton_stack, pallet

BLACK = painted("Black", 0.5)
WHITE = painted("White", 0.45)
STEEL = painted("Steel", 0.35, 1.0)
GREY = painted("LightGrey", 0.5)
OAK = textured("WoodOak", "#c39a66", 0.9)
WALNUT = textured("WoodWalnut", "#7a5233", 0.9)
SPINES = SurfaceMaterial("BookSpines", "#5a4a44", "BookSpines")


def cabinet(variant: int, rng: Generator) -> list[PropPiece]:
    """A drawer cabinet, a tall two-door locker, or an open book case full of books."""
    kind = variant % 3
    if kind == 0:
        body = block((-0.40, -0.22, 0.0), (0.40, 0.22, 1.05))
        fronts = [block((-0.38, -0.235, 0.04 + row * 0.335), (0.38, -0.22, 0.35 + row * 0.335)) for row in range(3)]
        grips = [block((-0.09, -0.255, 0.22 + row * 0.335), (0.09, -0.235, 0.245 + row * 0.335)) for row in range(3)]
        return [PropPiece(GREY, body), *(PropPiece(WHITE, m) for m in fronts), *(PropPiece(STEEL, m) for m in grips)]
    if kind == 1:
        body = block((-0.45, -0.22, 0.0), (0.45, 0.22, 1.9))
        doors = [block((x - 0.215, -0.235, 0.08), (x + 0.215, -0.22, 1.87)) for x in (-0.225, 0.225)]
        grips = [block((x - 0.012, -0.265, 0.95), (x + 0.012, -0.235, 1.15)) for x in (-0.05, 0.05)]
        return [
            PropPiece(painted("Charcoal"), body),
            *(PropPiece(GREY, m) for m in doors),
            *(PropPiece(BLACK, m) for m in grips),
        ]
    boards = [block((x - 0.02, -0.16, 0.0), (x + 0.02, 0.16, 1.85)) for x in (-0.43, 0.43)]
    boards.append(block((-0.43, 0.14, 0.0), (0.43, 0.158, 1.848)))
    boards += [block((-0.43, -0.158, 0.05 + row * 0.355), (0.43, 0.15, 0.08 + row * 0.355)) for row in range(6)]
    books = [_book_row(0.08 + row * 0.355, float(rng.uniform(0.05, 0.35))) for row in range(5)]
    return [*(PropPiece(OAK, mesh) for mesh in boards), *(PropPiece(SPINES, mesh) for mesh in books)]


def _book_row(z: float, gap: float) -> AuthoredMesh:
    return fitted_block((-0.41, -0.12, z), (0.41 - gap, 0.13, z + 0.27))


def kitchen_counter(variant: int, _rng: Generator) -> list[PropPiece]:
    """A row of kitchen units, 2.4 m long, with doors, worktop, tap, coffee machine and wall units above 1.4 m."""
    front = (painted("SkyBlue", 0.4), WHITE, painted("Teal", 0.4))[variant % 3]
    pieces = [PropPiece(painted("Charcoal"), block((-1.2, -0.26, 0.0), (1.2, 0.3, 0.10)))]
    pieces.append(PropPiece(WHITE, block((-1.2, -0.28, 0.10), (1.2, 0.3, 0.86))))
    pieces.append(PropPiece(WALNUT, block((-1.22, -0.32, 0.86), (1.22, 0.3, 0.90))))
    for door in range(4):
        x = -1.2 + 0.6 * door
        pieces.append(PropPiece(front, block((x + 0.01, -0.30, 0.12), (x + 0.59, -0.28, 0.84))))
        pieces.append(PropPiece(STEEL, block((x + 0.2, -0.32, 0.78), (x + 0.4, -0.30, 0.795))))
        pieces.append(PropPiece(front, block((x + 0.01, -0.04, 1.42), (x + 0.59, 0.3, 2.02))))
    pieces.append(
        PropPiece(
            STEEL,
            tube([(-0.5, 0.15, 0.9), (-0.5, 0.15, 1.15), (-0.5, 0.02, 1.18), (-0.5, -0.04, 1.12)], 0.015),
        )
    )
    pieces.append(PropPiece(BLACK, cushion((0.55, -0.15, 0.9), (0.85, 0.22, 1.28), 0.02)))
    pieces.append(PropPiece(painted("Red"), cylinder(0.07, 0.9, 1.05, (0.1, 0.05), 10)))
    return pieces


def fridge(_variant: int, _rng: Generator) -> list[PropPiece]:
    """A tall two-door fridge."""
    body = cushion((-0.30, -0.30, 0.02), (0.30, 0.32, 1.82), 0.02)
    doors = [cushion((-0.29, -0.335, z0), (0.29, -0.30, z1), 0.01) for z0, z1 in ((0.06, 1.05), (1.08, 1.80))]
    grips = [block((0.22, -0.37, z0), (0.245, -0.335, z1)) for z0, z1 in ((0.7, 1.0), (1.12, 1.4))]
    return [PropPiece(GREY, body), *(PropPiece(STEEL, m) for m in doors), *(PropPiece(BLACK, m) for m in grips)]


def coat_stand(_variant: int, rng: Generator) -> list[PropPiece]:
    """A pole with hooks and one or two coats."""
    pole = lathe([(0.17, 0.0), (0.17, 0.02), (0.025, 0.05), (0.022, 1.75)], sides=12)
    hooks = [
        tube([(0, 0, 1.7), (x, y, 1.66), (1.3 * x, 1.3 * y, 1.74)], 0.01, 4)
        for x, y in ((0.12, 0), (-0.12, 0), (0, 0.12))
    ]
    coat = lathe([(0.16, 0.75), (0.13, 1.2), (0.06, 1.62)], at=(0.13, 0.0), sides=8)
    paint = painted(("Navy", "Beige", "DarkRed")[int(rng.integers(3))], 0.95)
    return [PropPiece(BLACK, pole), *(PropPiece(BLACK, hook) for hook in hooks), PropPiece(paint, coat)]


def floor_lamp(_variant: int, _rng: Generator) -> list[PropPiece]:
    """A standing lamp with a lit shade."""
    foot = lathe([(0.15, 0.0), (0.15, 0.02), (0.015, 0.04), (0.012, 1.4)], sides=12)
    shade = lathe([(0.20, 1.35), (0.14, 1.65)], sides=16)
    return [PropPiece(BLACK, foot), PropPiece(glowing("LampShade", "#ffe9bd", glow=0.8), shade)]


def drinks_cooler(_variant: int, _rng: Generator) -> list[PropPiece]:
    """A water dispenser with its blue bottle."""
    body = cushion((-0.15, -0.15, 0.0), (0.15, 0.15, 0.98), 0.02)
    niche = block((-0.10, -0.155, 0.62), (0.10, -0.14, 0.85))
    bottle = lathe([(0.05, 0.97), (0.13, 1.05), (0.135, 1.2), (0.125, 1.22), (0.135, 1.24), (0.13, 1.38)], sides=14)
    return [PropPiece(WHITE, body), PropPiece(BLACK, niche), PropPiece(painted("SkyBlue", 0.2), bottle)]


def printer(_variant: int, _rng: Generator) -> list[PropPiece]:
    """A floor-standing copier with paper trays."""
    body = block((-0.28, -0.28, 0.04), (0.28, 0.28, 0.92))
    trays = [block((-0.26, -0.295, 0.08 + row * 0.17), (0.26, -0.28, 0.23 + row * 0.17)) for row in range(3)]
    lid = cushion((-0.29, -0.27, 0.92), (0.29, 0.28, 1.08), 0.03)
    panel = quad([(0.02, -0.271, 0.97), (0.24, -0.271, 0.97), (0.24, -0.271, 1.05), (0.02, -0.271, 1.05)])
    lit = glowing("PanelLit", "#5fb4e6", glow=0.8)
    return [
        PropPiece(GREY, body),
        *(PropPiece(WHITE, m) for m in trays),
        PropPiece(painted("Charcoal"), lid),
        PropPiece(lit, panel),
    ]


def reception(variant: int, _rng: Generator) -> list[PropPiece]:
    """A reception counter 2.6 m wide with a raised front and a coloured stripe."""
    stripe = (painted("Teal", 0.4), painted("Blue", 0.4), painted("Orange", 0.4))[variant % 3]
    front = block((-1.3, -0.35, 0.0), (1.3, -0.27, 1.10))
    top = cushion((-1.34, -0.42, 1.10), (1.34, -0.10, 1.14), 0.01)
    wings = [block((x - 0.04, -0.27, 0.0), (x + 0.04, 0.35, 1.10)) for x in (-1.26, 1.26)]
    band = block((-1.31, -0.36, 0.45), (1.31, -0.345, 0.62))
    work = block((-1.22, -0.27, 0.70), (1.22, 0.32, 0.74))
    return [
        PropPiece(WHITE, front),
        PropPiece(OAK, top),
        PropPiece(stripe, band),
        PropPiece(WHITE, work),
        *(PropPiece(WHITE, m) for m in wings),
    ]


def carton_pile(variant: int, rng: Generator) -> list[PropPiece]:
    """A few moving boxes on the floor, or a loaded pallet."""
    if variant % 2 == 0:
        first = fitted_block((-0.3, -0.2, 0.0), (0.3, 0.2, 0.4))
        second = moved(fitted_block((-0.22, -0.17, 0.4), (0.22, 0.17, 0.72)), yaw=0.25)
        return [PropPiece(CARTON, first), PropPiece(CARTONS[2], second)]
    return [*pallet(0.0, 0.0, 0.0), *carton_stack(0.0, 0.0, z=0.14, reach=(1.08, 0.94, 0.9), rng=rng)]


def pallet_pile(variant: int, rng: Generator) -> list[PropPiece]:
    """Four to seven empty pallets on top of each other, not quite aligned."""
    pieces: list[PropPiece] = []
    for level in range(4 + variant % 4):
        pieces.extend(pallet(float(rng.uniform(-0.03, 0.03)), float(rng.uniform(-0.03, 0.03)), 0.145 * level))
    return pieces


def pallet_truck(variant: int, _rng: Generator) -> list[PropPiece]:
    """A hand pallet truck: two forks, a pump head and a handle."""
    paint = painted(("Red", "Orange", "Yellow")[variant % 3], 0.4)
    forks = [cushion((x - 0.08, -1.1, 0.07), (x + 0.08, 0.1, 0.13), 0.015) for x in (-0.19, 0.19)]
    head = cushion((-0.27, 0.08, 0.05), (0.27, 0.30, 0.40), 0.04)
    shaft = rod((0.0, 0.24, 0.38), (0.0, 0.55, 1.15), 0.02)
    handle = tube([(-0.15, 0.55, 1.12), (-0.12, 0.6, 1.28), (0.12, 0.6, 1.28), (0.15, 0.55, 1.12)], 0.017)
    wheels = [moved(cylinder(0.08, -0.03, 0.03, sides=10), (x, 0.2, 0.08), pitch=1.5708) for x in (-0.12, 0.12)]
    wheels += [moved(cylinder(0.035, -0.05, 0.05, sides=8), (x, -0.95, 0.04), pitch=1.5708) for x in (-0.19, 0.19)]
    return [*(PropPiece(paint, m) for m in (*forks, head)), *(PropPiece(BLACK, m) for m in (shaft, handle, *wheels))]


def cone(_variant: int, _rng: Generator) -> list[PropPiece]:
    """An orange traffic cone with a white band."""
    body = cylinder(0.13, 0.03, 0.55, sides=14, top=0.025)
    band = uncapped(cylinder(0.098, 0.22, 0.34, sides=14, top=0.069))
    return [
        PropPiece(painted("Orange"), body),
        PropPiece(WHITE, band),
        PropPiece(BLACK, block((-0.17, -0.17, 0.0), (0.17, 0.17, 0.03))),
    ]


def protection_post(_variant: int, _rng: Generator) -> list[PropPiece]:
    """A yellow impact post with black bands, for the ends of racks."""
    bands = [uncapped(cylinder(0.062, z, z + 0.12, sides=8)) for z in (0.25, 0.55)]
    return [
        PropPiece(painted("Yellow"), cylinder(0.06, 0.0, 0.8, sides=8)),
        *(PropPiece(BLACK, band) for band in bands),
    ]


def workbench(_variant: int, _rng: Generator) -> list[PropPiece]:
    """A packing bench with rolls and a box; its name, `SM_Workbench`, matches no category rule."""
    top = block((-0.9, -0.4, 0.86), (0.9, 0.4, 0.92))
    legs = [block((x - 0.04, y - 0.04, 0.0), (x + 0.04, y + 0.04, 0.86)) for x in (-0.82, 0.82) for y in (-0.33, 0.33)]
    low = block((-0.85, -0.3, 0.25), (0.85, 0.35, 0.28))
    goods = fitted_block((-0.6, -0.2, 0.92), (-0.15, 0.15, 1.22))
    roll = moved(cylinder(0.09, -0.25, 0.25, sides=12), (0.45, 0.1, 1.01), pitch=1.5708)
    return [
        PropPiece(ROUGH, top),
        *(PropPiece(painted("Blue"), leg) for leg in legs),
        PropPiece(GREY, low),
        PropPiece(CARTON, goods),
        PropPiece(WHITE, roll),
    ]
