"""Builders of pallet racks, shelves, barrels and crates with their loads: metres, origin on the floor, front at -y.

A rack is one 2.7 m bay. The names of loads match no category rule. Does not place props.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.random import Generator

from factory.scenes.author.geometry import (
    AuthoredMesh,
    Vector,
    block,
    cylinder,
    lathe,
    loft,
    moved,
    open_block,
    rod,
    standing_block,
    uncapped,
)
from factory.scenes.author.materials import PAINTS, PropPiece, SurfaceMaterial, painted, textured, tinted

BLACK = painted("Black", 0.5)
STEEL = painted("Steel", 0.4, 1.0)
ROUGH = textured("WoodRough", "#b3905f", 0.8, 0.9)
CARTON = SurfaceMaterial("Carton", "#b48a5a", "Carton", roughness=0.9)
CARTONS = (
    CARTON,
    CARTON,
    SurfaceMaterial("CartonPrinted", "#a67c4e", "CartonPrinted", roughness=0.9),
    SurfaceMaterial("CartonWhite", "#dcd6c8", "CartonWhite", roughness=0.9),
)
WRAP = SurfaceMaterial("Wrapped", "#b9b4a6", "Wrapped", roughness=0.25)
TOTES = tuple(tinted("Tote", f"Tote{paint}", PAINTS[paint]) for paint in ("Blue", "Grey", "Green", "Red", "Yellow"))
FRAMES = tuple(
    (painted(a, 0.5), painted(b, 0.5)) for a, b in (("Blue", "Orange"), ("Green", "Orange"), ("Grey", "Yellow"))
)

# fmt: off
TIGHT_HEAD = (
    (0.25, 0.0), (0.29, 0.05), (0.29, 0.28), (0.273, 0.315), (0.29, 0.35), (0.29, 0.62), (0.273, 0.655), (0.29, 0.69),
    (0.28, 0.86), (0.24, 0.92), (0.21, 0.92), (0.205, 0.90),
)
RINGED = (
    (0.295, 0.0), (0.285, 0.03), (0.285, 0.28), (0.30, 0.30), (0.285, 0.32), (0.285, 0.57), (0.30, 0.59),
    (0.285, 0.61), (0.285, 0.86), (0.295, 0.875), (0.275, 0.89), (0.27, 0.875),
)
KEG = (
    (0.19, 0.0), (0.22, 0.04), (0.22, 0.46), (0.20, 0.50), (0.20, 0.53), (0.225, 0.53), (0.225, 0.57), (0.02, 0.59),
)
# fmt: on


def pallet(x: float, y: float, z: float, half_x: float = 0.58, half_y: float = 0.5) -> list[PropPiece]:
    """A wooden pallet 0.14 m high centred at (x, y), standing at height z."""
    bars = [
        standing_block((x - half_x, y + row - 0.05, z), (x + half_x, y + row + 0.05, z + 0.10), lid=False)
        for row in (-half_y + 0.05, half_y - 0.05)
    ]
    deck = standing_block((x - half_x, y - half_y, z + 0.10), (x + half_x, y + half_y, z + 0.14))
    return [PropPiece(ROUGH, mesh) for mesh in (*bars, deck)]


def carton_stack(x: float, y: float, z: float, reach: Vector, rng: Generator) -> list[PropPiece]:
    """Cartons filling a box of size `reach` from height z upwards, with uneven tops."""
    across = int(rng.integers(1, 3))
    pieces: list[PropPiece] = []
    width = reach[0] / across
    for column in range(across):
        left, height, rows = x - reach[0] / 2 + column * width, 0.0, int(rng.integers(1, 3))
        step = reach[2] / rows * float(rng.uniform(0.75, 1.0))
        look = CARTONS[int(rng.integers(len(CARTONS)))]
        for _ in range(rows):
            inset = float(rng.uniform(0.005, 0.035))
            low = (left + inset, y - reach[1] / 2 + inset, z + height)
            high = (left + width - inset, y + reach[1] / 2 - inset, z + height + step - 0.004)
            pieces.append(PropPiece(look, standing_block(low, high, fitted=True)))
            height += step
    return pieces


def _load(x: float, z: float, room: float, rng: Generator) -> list[PropPiece]:
    """One loaded pallet 1.16 m wide, or nothing, below a clear height of `room` metres."""
    kind = float(rng.random())
    if kind < 0.10:
        return []
    base = [
        PropPiece(ROUGH, standing_block((x - 0.58, -0.38, z), (x + 0.58, 0.38, z + 0.14)))
    ]  # a solid block, because the front bar of a pallet hides the gap behind it
    top, height = z + 0.14, float(rng.uniform(0.55, 0.85)) * (room - 0.2)
    if kind < 0.68:
        return [*base, *carton_stack(x, 0.0, z=top, reach=(1.08, 0.72, height), rng=rng)]
    if kind < 0.84:
        wrapped = standing_block((x - 0.52, -0.36, top), (x + 0.52, 0.36, top + height), fitted=True)
        return [*base, PropPiece(WRAP, wrapped)]
    tote = TOTES[int(rng.integers(len(TOTES)))]
    size = height / 2
    boxes = [
        standing_block(
            (x + side - 0.24, -0.35, top + level * size),
            (x + side + 0.24, 0.35, top + (level + 0.94) * size),
            fitted=True,
        )
        for side in (-0.26, 0.26)
        for level in range(2)
    ]
    return [*base, *(PropPiece(tote, mesh) for mesh in boxes)]


def rack(variant: int, rng: Generator) -> list[PropPiece]:
    """A pallet rack bay 2.7 m wide and 0.84 m deep with uprights, braces, beams and loaded levels."""
    upright, beam = FRAMES[variant % 3]
    levels = ((0.0, 1.35, 2.60), (0.0, 1.15, 2.20, 3.25), (0.0, 1.55, 2.95))[variant // 3 % 3]
    top = levels[-1] + 0.95
    steel: list[AuthoredMesh] = []
    for x in (-1.30, 1.30):
        for y in (-0.38, 0.38):
            steel.append(standing_block((x - 0.045, y - 0.04, 0.0), (x + 0.045, y + 0.04, top)))
        zigzag = [0.15 + step * (top - 0.3) / 4 for step in range(5)]
        for step, (z0, z1) in enumerate(pairwise(zigzag)):
            side = 0.35 if step % 2 else -0.35
            steel.append(uncapped(rod((x, -side, z0), (x, side, z1), 0.018, 3)))
    pieces = [PropPiece(upright, mesh) for mesh in steel]
    for y in (-0.38, 0.38):
        for z in levels[1:]:
            pieces.append(PropPiece(beam, open_block((-1.255, y - 0.025, z - 0.12), (1.255, y + 0.025, z), "SNBT")))
    for z in levels[1:]:
        pieces.append(PropPiece(STEEL, open_block((-1.255, -0.355, z - 0.03), (1.255, 0.355, z - 0.005), "BT")))
    ceilings = [*(level - 0.15 for level in levels[1:]), top]
    for z, ceiling in zip(levels, ceilings, strict=True):
        for x in (-0.63, 0.63):
            pieces.extend(_load(x, z, ceiling - z, rng))
    return pieces


def shelf(variant: int, rng: Generator) -> list[PropPiece]:
    """A shelf unit 0.9-1.2 m wide: boltless steel, painted steel with totes, wood, or bright wire."""
    kind = variant % 4
    half_x, half_y, height, decks = (
        (0.60, 0.25, 2.0, 5),
        (0.50, 0.22, 1.8, 4),
        (0.60, 0.25, 2.2, 5),
        (0.45, 0.23, 1.7, 4),
    )[kind]
    frame = (painted("Grey", 0.5), painted("Blue", 0.5), ROUGH, STEEL)[kind]
    plank = (ROUGH, painted("LightGrey", 0.5), ROUGH, STEEL)[kind]
    pieces = [
        PropPiece(frame, standing_block((x - 0.025, y - 0.025, 0.0), (x + 0.025, y + 0.025, height)))
        for x in (-half_x + 0.025, half_x - 0.025)
        for y in (-half_y + 0.025, half_y - 0.025)
    ]
    step = (height - 0.16) / (decks - 1)
    for deck in range(decks):
        z = 0.12 + deck * step
        low, high = (-half_x + 0.003, -half_y + 0.003, z - 0.03), (half_x - 0.003, half_y - 0.003, z)
        pieces.append(PropPiece(plank, block(low, high)))  # not flush with the posts, which would cause z-fighting
        if deck < decks - 1:
            pieces.extend(_shelf_goods(half_x - 0.06, half_y - 0.04, z=z, room=step - 0.06, kind=kind, rng=rng))
    for x in (-half_x + 0.025, half_x - 0.025):
        brace = rod((x, -half_y + 0.03, 0.2), (x, half_y - 0.03, height - 0.2), 0.012, 4)
        pieces.append(PropPiece(frame, uncapped(brace)))
    return pieces


def _shelf_goods(half_x: float, half_y: float, z: float, room: float, kind: int, rng: Generator) -> list[PropPiece]:
    """Boxes side by side on one shelf deck, with occasional gaps."""
    pieces: list[PropPiece] = []
    x = -half_x
    while x < half_x - 0.16:
        width = min(float(rng.uniform(0.22, 0.42)), half_x - x)
        if rng.random() < 0.82:
            tall = room * float(rng.uniform(0.45, 0.95))
            low, high = (
                (x + 0.01, -half_y, z),
                (x + width - 0.01, half_y * float(rng.uniform(0.6, 1.0)), z + tall),
            )
            if kind in (1, 3) or rng.random() < 0.15:
                pieces.append(PropPiece(TOTES[int(rng.integers(len(TOTES)))], standing_block(low, high, fitted=True)))
            else:
                pieces.append(
                    PropPiece(CARTONS[int(rng.integers(len(CARTONS)))], standing_block(low, high, fitted=True))
                )
        x += width
    return pieces


def barrel(variant: int, _rng: Generator) -> list[PropPiece]:
    """A plastic tight-head barrel, a ringed steel drum or a small keg, in one dominant colour."""
    kind = variant % 3
    profile: tuple[tuple[float, float], ...]
    if kind == 0:
        paint = painted(("Blue", "Black", "White")[variant // 3 % 3], 0.4)
        profile = TIGHT_HEAD
        height = 0.90
    elif kind == 1:
        paint = painted(("Red", "Green", "Orange")[variant // 3 % 3], 0.35)
        profile = RINGED
        height = 0.875
    else:
        paint = painted(("Blue", "Yellow", "Green")[variant // 3 % 3], 0.4)
        profile = KEG
        height = 0.575
    bungs = [cylinder(0.03, height, height + 0.025, (x, 0.0), 6) for x in (-0.12, 0.13)]
    return [
        PropPiece(paint, lathe(profile, sides=16)),
        *(PropPiece(BLACK if kind else STEEL, bung) for bung in bungs),
    ]


def plastic_crate(variant: int, rng: Generator) -> list[PropPiece]:
    """A slotted plastic crate 0.6 x 0.4 m, single or stacked two or three high, filled to 0.1 m below its rim."""
    paint = painted(("Green", "Red", "Blue", "Yellow")[variant % 4], 0.45)
    high = (2, 1, 3)[variant // 4 % 3]
    meshes: list[AuthoredMesh] = []
    for level in range(high):
        z, twist = level * 0.30, float(rng.uniform(-0.04, 0.04))
        shell = _crate_shell(level == high - 1)
        meshes.extend(moved(mesh, (0.0, 0.0, z), yaw=twist) for mesh in shell)
    fill = standing_block((-0.27, -0.17, 0.03), (0.27, 0.17, high * 0.30 - 0.10))
    return [*(PropPiece(paint, mesh) for mesh in meshes), PropPiece(painted("Charcoal"), fill)]


def _crate_shell(is_topmost: bool) -> list[AuthoredMesh]:
    """Corner posts and three rails all round, 0.29 m high; the upper rail of the topmost crate is also visible from
    inside."""
    meshes = [_rail(0.0, 0.06), _rail(0.10, 0.17), _rail(0.21, 0.29, is_topmost)]
    posts = [(x, y) for x in (-0.27, 0.27) for y in (-0.17, 0.17)]
    return [*meshes, *(standing_block((x - 0.032, y - 0.032, 0.0), (x + 0.032, y + 0.032, 0.285)) for x, y in posts)]


def _rail(low: float, high: float, has_inside: bool = False) -> AuthoredMesh:
    """A rail around the crate between two heights. A ledge at its lower and upper edge joins it to the filling.

    The rail is 2 cm thick. With `has_inside`, its inner face replaces the upper ledge.
    """
    inside = [(0.02, high), (0.05, low - 0.04)] if has_inside else [(0.035, high)]
    outlines = [(0.30 - inset, 0.20 - inset, z) for inset, z in [(0.035, low), (0.0, low), (0.0, high), *inside]]
    return uncapped(loft(np.array([[(-x, -y, z), (x, -y, z), (x, y, z), (-x, y, z)] for x, y, z in outlines])))


def pallet_crate(variant: int, _rng: Generator) -> list[PropPiece]:
    """A nailed wooden crate with slats and corner battens, three sizes."""
    half_x, half_y, height = ((0.38, 0.30, 0.55), (0.45, 0.38, 0.75), (0.32, 0.32, 0.45))[variant % 3]
    wood, batten = ((ROUGH, painted("Brown", 0.9)), (textured("WoodOak", "#c39a66", 0.7), ROUGH))[variant // 3 % 2]
    core = standing_block((-half_x + 0.02, -half_y + 0.02, 0.05), (half_x - 0.02, half_y - 0.02, height), lid=False)
    pieces = [PropPiece(painted("Brown", 0.9), core)]
    slats = 4
    pitch = (height - 0.06) / slats
    for slat in range(slats):
        z0, z1 = 0.06 + slat * pitch, 0.06 + (slat + 0.86) * pitch
        pieces.append(
            PropPiece(
                wood, standing_block((-half_x + 0.005, -half_y + 0.005, z0), (half_x - 0.005, half_y - 0.005, z1))
            )
        )
    pieces.append(PropPiece(wood, block((-half_x, -half_y, height - 0.01), (half_x, half_y, height + 0.015))))
    for x in (-half_x, half_x):
        for y in (-half_y, half_y):
            pieces.append(PropPiece(batten, standing_block((x - 0.04, y - 0.015, 0.0), (x + 0.04, y + 0.015, height))))
    for y in (-half_y, half_y):
        brace = rod((-half_x + 0.04, y, 0.10), (half_x - 0.04, y, height - 0.06), 0.022, 4)
        pieces.append(PropPiece(batten, uncapped(brace)))
    return pieces
