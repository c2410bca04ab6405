"""Builders for bathrooms and laundries: toilets, bathtubs, basins, washing machines, towel rails.

Lengths in metres, origin on the floor, front facing -y. Does not place props.
"""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from factory.scenes.author.geometry import (
    AuthoredMesh,
    block,
    cushion,
    cylinder,
    lathe,
    loft,
    moved,
    open_block,
    pad,
    quad,
    rod,
    tube,
)
from factory.scenes.author.materials import PropPiece, SurfaceMaterial, cloth, painted, wood

CERAMIC = painted("White", 0.2)
CHROME = painted("Chrome", 0.25, 1.0)
BLACK = painted("Black", 0.5)
MIRROR = SurfaceMaterial("MirrorGlass", "#c4d3da", roughness=0.05)


def _oval(z: float, half_x: float, y0: float, y1: float, sides: int = 14) -> list[tuple[float, float, float]]:
    """A ring of points at height z, from y0 to y1."""
    middle, half_y = (y0 + y1) / 2, (y1 - y0) / 2
    turns = 2 * np.pi * np.arange(sides) / sides
    return [(half_x * float(np.cos(t)), middle + half_y * float(np.sin(t)), z) for t in turns]


def toilet(variant: int, _rng: Generator) -> list[PropPiece]:
    """A toilet with a cistern, or a wall-hung one before a boxed cistern; the lid is closed or open."""
    bowl = loft(
        np.array([_oval(0.0, 0.11, -0.22, 0.16), _oval(0.16, 0.12, -0.24, 0.18), _oval(0.38, 0.19, -0.34, 0.20)])
    )
    lid = loft(np.array([_oval(0.385, 0.195, -0.35, 0.19), _oval(0.42, 0.19, -0.34, 0.18)]))
    tank = cushion((-0.20, 0.18, 0.36), (0.20, 0.36, 0.80), 0.03)
    foot = block((-0.10, 0.10, 0.0), (0.10, 0.34, 0.36))
    button = cylinder(0.03, 0.80, 0.812, (0.0, 0.27), 10)
    pieces = [PropPiece(CERAMIC, mesh) for mesh in (bowl, tank, foot)]
    if variant % 3 == 1:
        raised = moved(
            loft(np.array([_oval(0.0, 0.19, 0.0, 0.50), _oval(0.03, 0.185, 0.0, 0.49)])), (0.0, 0.16, 0.41), roll=1.45
        )
        water = quad([(-0.09, -0.24, 0.382), (0.09, -0.24, 0.382), (0.09, 0.10, 0.382), (-0.09, 0.10, 0.382)])
        pieces += [PropPiece(CERAMIC, raised), PropPiece(painted("SkyBlue", 0.1), water)]
    else:
        pieces.append(PropPiece(CERAMIC if variant % 3 == 0 else wood("Pale"), lid))
    return [*pieces, PropPiece(CHROME, button)]


def bathtub(variant: int, _rng: Generator) -> list[PropPiece]:
    """A built-in tub with a panel, or a free-standing oval tub, with a tap."""
    if variant % 3 == 1:
        rings = [
            _oval(0.0, 0.30, -0.62, 0.62),
            _oval(0.15, 0.33, -0.70, 0.70),
            _oval(0.58, 0.40, -0.82, 0.82),
            _oval(0.58, 0.36, -0.78, 0.78),
            _oval(0.30, 0.28, -0.66, 0.66),
        ]
        tub = moved(loft(np.array(rings)), yaw=np.pi / 2)
        tap = tube([(0.86, 0.0, 0.0), (0.86, 0.0, 0.82), (0.74, 0.0, 0.84), (0.70, 0.0, 0.78)], 0.016)
        return [PropPiece(CERAMIC, tub), PropPiece(CHROME, tap)]
    half_x, half_y = (0.85, 0.38) if variant % 3 == 0 else (0.80, 0.40)
    outline = ((0.0, 0.0), (0.0, 0.56), (0.07, 0.56), (0.14, 0.22))
    rings = [
        [
            (x, y, z)
            for x, y in (
                (-half_x + i, -half_y + i),
                (half_x - i, -half_y + i),
                (half_x - i, half_y - i),
                (-half_x + i, half_y - i),
            )
        ]
        for i, z in outline
    ]
    tap = tube(
        [
            (-half_x + 0.05, 0.0, 0.56),
            (-half_x + 0.05, 0.0, 0.74),
            (-half_x + 0.2, 0.0, 0.74),
            (-half_x + 0.22, 0.0, 0.70),
        ],
        0.016,
    )
    pieces = [PropPiece(CERAMIC, loft(np.array(rings))), PropPiece(CHROME, tap)]
    water = quad(
        [
            (-half_x + 0.13, -half_y + 0.13, 0.24),
            (half_x - 0.13, -half_y + 0.13, 0.24),
            (half_x - 0.13, half_y - 0.13, 0.24),
            (-half_x + 0.13, half_y - 0.13, 0.24),
        ]
    )
    return [*pieces, PropPiece(painted("SkyBlue", 0.1), water)]


def basin(variant: int, _rng: Generator) -> list[PropPiece]:
    """A wash basin on a cupboard, on a pedestal or as a bowl on a board, with a tap and a mirror."""
    mirror = open_block((-0.28, 0.205, 1.10), (0.28, 0.22, 1.75), "SEWBT")
    tap = tube([(0.0, 0.15, 0.86), (0.0, 0.15, 1.02), (0.0, 0.04, 1.03), (0.0, 0.01, 0.98)], 0.014)
    pieces = [PropPiece(MIRROR, mirror), PropPiece(CHROME, tap)]
    if variant % 3 == 1:
        column = lathe([(0.11, 0.0), (0.08, 0.10), (0.08, 0.60), (0.14, 0.72)], (0.0, 0.06), 12)
        bowl = loft(
            np.array(
                [
                    _oval(0.70, 0.20, -0.14, 0.20),
                    _oval(0.86, 0.29, -0.22, 0.22),
                    _oval(0.86, 0.25, -0.18, 0.14),
                    _oval(0.78, 0.12, -0.08, 0.06),
                ]
            )
        )
        return [*pieces, PropPiece(CERAMIC, column), PropPiece(CERAMIC, bowl)]
    front = (CERAMIC, None, wood("Walnut"))[variant % 3] or CERAMIC
    chest = block((-0.33, -0.20, 0.12), (0.33, 0.22, 0.78))
    doors = [open_block((x - 0.155, -0.218, 0.15), (x + 0.155, -0.20, 0.75), "SEWBT") for x in (-0.16, 0.16)]
    foot = block((-0.29, -0.14, 0.0), (0.29, 0.22, 0.12))
    top = pad((-0.35, -0.24, 0.78), (0.35, 0.22, 0.86), 0.02)
    hollow = quad([(-0.2, -0.16, 0.863), (0.2, -0.16, 0.863), (0.2, 0.09, 0.863), (-0.2, 0.09, 0.863)])
    return [
        *pieces,
        PropPiece(front, chest),
        *(PropPiece(front, door) for door in doors),
        PropPiece(BLACK, foot),
        PropPiece(CERAMIC, top),
        PropPiece(painted("LightGrey", 0.3), hollow),
    ]


def washing_machine(variant: int, _rng: Generator) -> list[PropPiece]:
    """A front loader with a round door: white, grey or black."""
    case = (CERAMIC, painted("LightGrey", 0.4), painted("Black", 0.4))[variant % 3]
    body = cushion((-0.30, -0.28, 0.02), (0.30, 0.30, 0.86), 0.012)
    rim = moved(cylinder(0.20, 0.0, 0.03, sides=20), (0.0, -0.28, 0.42), roll=1.5708)
    glass = moved(cylinder(0.155, 0.004, 0.045, sides=18, top=0.13), (0.0, -0.28, 0.42), roll=1.5708)
    panel = open_block((0.02, -0.286, 0.74), (0.26, -0.28, 0.82), "SEWBT")
    drawer = open_block((-0.27, -0.288, 0.73), (-0.04, -0.28, 0.83), "SEWBT")
    foot = block((-0.26, -0.22, 0.0), (0.26, 0.26, 0.02))
    return [
        PropPiece(case, body),
        PropPiece(CHROME, rim),
        PropPiece(painted("Charcoal", 0.2), glass),
        PropPiece(painted("Charcoal"), panel),
        PropPiece(case, drawer),
        PropPiece(BLACK, foot),
    ]


def towel_rail(variant: int, _rng: Generator) -> list[PropPiece]:
    """A rail on the wall with a towel; the wall plane is y = 0."""
    rail = rod((-0.32, -0.08, 1.25), (0.32, -0.08, 1.25), 0.012, 6)
    holds: list[AuthoredMesh] = [rod((x, 0.0, 1.25), (x, -0.08, 1.25), 0.010, 5) for x in (-0.31, 0.31)]
    towel = block((-0.22, -0.105, 0.75), (0.18, -0.055, 1.27))
    return [
        PropPiece(CHROME, rail),
        *(PropPiece(CHROME, hold) for hold in holds),
        PropPiece(cloth(("Teal", "White", "Pink", "Navy")[variant % 4]), towel),
    ]
