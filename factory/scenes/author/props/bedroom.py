"""Builders of beds, lounge seats and luggage: beds, ottomans, benches, baskets, bags and suitcases.

Lengths in metres, origin on the floor, front facing -y; the head of a bed is at +y. Does not place props.
"""

from __future__ import annotations

from numpy.random import Generator

from factory.scenes.author.geometry import (
    AuthoredMesh,
    block,
    cushion,
    cylinder,
    lathe,
    moved,
    pad,
    rod,
    tube,
    uncapped,
)
from factory.scenes.author.materials import PropPiece, SurfaceMaterial, cloth, painted, tinted, wood

WHITE = painted("White", 0.6)
BLACK = painted("Black", 0.6)
CHROME = painted("Chrome", 0.25, 1.0)
BEDDING = tuple(cloth(paint) for paint in ("Navy", "White", "Green", "DarkRed", "SkyBlue", "Grey"))
SEATS = tuple(cloth(paint) for paint in ("Blue", "Green", "Red", "Grey", "Orange", "Yellow"))
WICKER = tinted("Cloth", "Wicker", colour="#b98a52", tile_m=0.25, roughness=0.9)


def bed(variant: int, _rng: Generator) -> list[PropPiece]:
    """A double or a single bed with head board, mattress, quilt and pillows."""
    half = (0.80, 0.80, 0.50, 0.70)[variant % 4]
    frame = (wood("Oak"), WHITE, wood("Walnut"), cloth("Grey"))[variant % 4]
    cover = BEDDING[variant % len(BEDDING)]
    meshes = [
        block((-half - 0.03, -1.02, 0.14), (half + 0.03, 1.0, 0.30)),
        block((-half - 0.05, 1.0, 0.02), (half + 0.05, 1.06, (1.05, 0.95, 0.85, 1.15)[variant % 4])),
        *(block((x - 0.04, -0.98, 0.0), (x + 0.04, -0.90, 0.14)) for x in (-half + 0.02, half - 0.02)),
    ]
    mattress = pad((-half, -0.99, 0.30), (half, 0.99, 0.50), 0.04)
    quilt = pad((-half - 0.035, -1.0, 0.33), (half + 0.035, 0.45, 0.54), 0.05)
    middles = (0.0,) if half < 0.6 else (-half / 2, half / 2)
    pillows = [
        moved(pad((-0.32, -0.2, 0.0), (0.32, 0.2, 0.14), 0.05, is_loose=True), (x, 0.74, 0.50), roll=0.16)
        for x in middles
    ]
    return [
        *(PropPiece(frame, mesh) for mesh in meshes),
        *(PropPiece(WHITE, mesh) for mesh in (mattress, *pillows)),
        PropPiece(cover, quilt),
    ]


def ottoman(variant: int, _rng: Generator) -> list[PropPiece]:
    """A round pouf, or a square footstool on legs."""
    cover = SEATS[variant % len(SEATS)]
    if variant % 2 == 0:
        return [PropPiece(cover, lathe([(0.27, 0.0), (0.31, 0.08), (0.31, 0.30), (0.26, 0.38)], sides=18))]
    legs = [cylinder(0.02, 0.0, 0.14, (x, y), 6) for x in (-0.22, 0.22) for y in (-0.22, 0.22)]
    top = cushion((-0.28, -0.28, 0.14), (0.28, 0.28, 0.40), 0.05)
    return [PropPiece(cover, top), *(PropPiece(wood("Oak"), leg) for leg in legs)]


def bench(variant: int, _rng: Generator) -> list[PropPiece]:
    """A wooden bench, some variants with a cushion or a back."""
    finish = (wood("Oak"), wood("Walnut"), WHITE)[variant % 3]
    half = (0.55, 0.60, 0.50)[variant % 3]
    meshes = [block((-half, -0.18, 0.40), (half, 0.18, 0.44))]
    meshes += [block((x - 0.025, -0.15, 0.0), (x + 0.025, 0.15, 0.40)) for x in (-half + 0.08, half - 0.08)]
    meshes.append(block((-half + 0.105, -0.02, 0.12), (half - 0.105, 0.02, 0.16)))
    if variant % 3 == 2:
        meshes += [block((x - 0.02, 0.14, 0.44), (x + 0.02, 0.18, 0.85)) for x in (-half + 0.04, half - 0.04)]
        meshes += [block((-half, 0.145, z), (half, 0.175, z + 0.09)) for z in (0.60, 0.74)]
    pieces = [PropPiece(finish, mesh) for mesh in meshes]
    if variant % 3 == 0:
        pieces.append(PropPiece(cloth("Beige"), pad((-half + 0.02, -0.17, 0.44), (half - 0.02, 0.17, 0.48), 0.015)))
    return pieces


def armchair(variant: int, _rng: Generator) -> list[PropPiece]:
    """A padded chair with arms, on short legs or with an open wooden frame."""
    cover = SEATS[variant % len(SEATS)]
    seat = cushion((-0.27, -0.36, 0.27), (0.27, 0.22, 0.43), 0.04)
    back = moved(cushion((-0.28, -0.07, 0.0), (0.28, 0.07, 0.52), 0.05), (0.0, 0.28, 0.36), roll=-0.16)
    legs = [cylinder(0.02, 0.0, 0.27, (x, y), 6) for x in (-0.27, 0.27) for y in (-0.30, 0.26)]
    if variant % 2 == 0:
        arms = [cushion((x - 0.07, -0.36, 0.14), (x + 0.07, 0.30, 0.58), 0.035) for x in (-0.33, 0.33)]
        return [*(PropPiece(cover, m) for m in (seat, back, *arms)), *(PropPiece(wood("Oak"), leg) for leg in legs)]
    frame = [
        tube([(x, -0.32, 0.0), (x, -0.34, 0.55), (x, 0.30, 0.50), (x, 0.36, 0.0)], 0.022, 5) for x in (-0.33, 0.33)
    ]
    bars = [rod((-0.33, y, 0.26), (0.33, y, 0.26), 0.018, 5) for y in (-0.30, 0.24)]
    return [PropPiece(cover, seat), PropPiece(cover, back), *(PropPiece(wood("Walnut"), m) for m in (*frame, *bars))]


def _tub(radius: float, height: float, bottom: float) -> AuthoredMesh:
    """An open round container with a visible inside."""
    return lathe([(bottom, 0.0), (radius, height), (radius - 0.02, height), (bottom - 0.02, 0.04)], sides=16)


def basket(variant: int, _rng: Generator) -> list[PropPiece]:
    """A wicker or plastic basket with laundry."""
    finish: SurfaceMaterial = (WICKER, painted("White", 0.5), WICKER, painted("Pink", 0.5))[variant % 4]
    radius, height = ((0.24, 0.42), (0.22, 0.55), (0.20, 0.30), (0.23, 0.48))[variant % 4]
    filling = lathe([(radius - 0.03, height - 0.10), (0.4 * radius, height + 0.01)], sides=10)
    return [
        PropPiece(finish, _tub(radius, height, radius - 0.04)),
        PropPiece((WHITE, cloth("SkyBlue"), cloth("Pink"))[variant % 3], filling),
    ]


def suitcase(variant: int, _rng: Generator) -> list[PropPiece]:
    """A hard case with ribs, a pull handle and four wheels."""
    shell = painted(("Red", "Blue", "Black", "Green")[variant % 4], 0.35)
    height = (0.62, 0.72, 0.54, 0.66)[variant % 4]
    body = cushion((-0.22, -0.13, 0.05), (0.22, 0.13, height), 0.04)
    ribs = [block((x - 0.015, -0.138, 0.12), (x + 0.015, 0.138, height - 0.07)) for x in (-0.13, 0.0, 0.13)]
    grip = height + 0.3
    handle = [rod((x, 0.08, height - 0.02), (x, 0.08, grip), 0.009, 5) for x in (-0.09, 0.09)]
    handle.append(rod((-0.1, 0.08, grip), (0.1, 0.08, grip), 0.014, 5))
    wheels = [cylinder(0.025, 0.0, 0.05, (x, y), 8) for x in (-0.17, 0.17) for y in (-0.09, 0.09)]
    return [
        PropPiece(shell, body),
        *(PropPiece(shell, rib) for rib in ribs),
        *(PropPiece(CHROME, mesh) for mesh in handle),
        *(PropPiece(BLACK, wheel) for wheel in wheels),
    ]


def backpack(variant: int, _rng: Generator) -> list[PropPiece]:
    """A school bag with a front pocket, a lid and shoulder straps, upright on the floor."""
    fabric = cloth(("Blue", "Red", "Green", "Purple")[variant % 4])
    body = cushion((-0.16, -0.09, 0.0), (0.16, 0.10, 0.42), 0.05)
    pocket = cushion((-0.12, -0.15, 0.03), (0.12, -0.07, 0.24), 0.03)
    lid = cushion((-0.165, -0.11, 0.33), (0.165, 0.105, 0.45), 0.04)
    loop = tube([(-0.05, 0.08, 0.43), (-0.04, 0.08, 0.50), (0.04, 0.08, 0.50), (0.05, 0.08, 0.43)], 0.009, 4)
    straps = [tube([(x, 0.10, 0.40), (x * 1.2, 0.16, 0.28), (x, 0.11, 0.05)], 0.016, 4) for x in (-0.1, 0.1)]
    buckle = block((-0.02, -0.160, 0.20), (0.02, -0.149, 0.26))
    return [
        *(PropPiece(fabric, mesh) for mesh in (body, pocket, lid)),
        *(PropPiece(BLACK, mesh) for mesh in (loop, *straps, buckle)),
    ]


def curtains(variant: int, _rng: Generator) -> list[PropPiece]:
    """Two curtains in folds on a rod, beside a window of 1.6 m."""
    fabric = cloth(("Beige", "Grey", "Teal", "DarkRed", "Navy", "White")[variant % 6])
    pieces = [PropPiece(BLACK, rod((-1.22, -0.09, 2.32), (1.22, -0.09, 2.32), 0.014, 5))]
    for side in (-1.0, 1.0):
        for fold in range(5):
            x = side * (0.86 + 0.075 * fold)
            strip = uncapped(cylinder(0.045, 0.72, 2.30, (x, -0.08), 6, top=0.04))
            pieces.append(PropPiece(fabric, strip))
    return pieces
