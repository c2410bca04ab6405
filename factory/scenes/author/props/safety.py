"""Builders of fire extinguishers and whiteboards: metres, origin on the floor below them, front facing -y.

The mesh of a wall-mounted prop includes its mounting height. Does not place props.
"""

from __future__ import annotations

from numpy.random import Generator

from factory.scenes.author.geometry import (
    AuthoredMesh,
    Vector,
    block,
    cushion,
    cylinder,
    lathe,
    moved,
    quad,
    rod,
    tube,
)
from factory.scenes.author.materials import PropPiece, SurfaceMaterial, painted

RED = painted("Red", 0.3)
BLACK = painted("Black", 0.5)
STEEL = painted("Steel", 0.3, 1.0)
BRIGHT = painted("White", 0.3)
SCRIBBLES = SurfaceMaterial("Scribbles", "#f4f5f4", "Scribbles", roughness=0.2)


def fire_extinguisher(variant: int, _rng: Generator) -> list[PropPiece]:
    """A red bottle with valve, gauge, lever and hose: on a floor stand, wall-hung, or a wheeled large one."""
    kind = variant % 3
    radius, height = ((0.085, 0.44), (0.075, 0.40), (0.10, 0.56))[kind]
    bottom = (0.05, 0.28, 0.06)[kind]
    top = bottom + height
    bottle = lathe(
        [
            (radius * 0.9, bottom),
            (radius, bottom + 0.02),
            (radius, top - 0.08),
            (radius * 0.75, top - 0.03),
            (0.03, top),
        ],
        sides=12,
    )
    valve = cylinder(0.022, top, top + 0.05, sides=8)
    levers = [
        moved(
            block((-0.012, -0.02, 0.0), (0.012, 0.13, 0.015)),
            (0.0, -0.02, top + 0.05),
            yaw=1.57,
            pitch=0.0,
            roll=0.25,
        ),
        moved(block((-0.012, -0.02, 0.0), (0.012, 0.12, 0.015)), (0.0, -0.02, top + 0.03), yaw=1.57, roll=-0.1),
    ]
    gauge = moved(cylinder(0.022, 0.0, 0.015, sides=8), (0.0, -0.02, top + 0.02), roll=1.57)
    x = radius + 0.025
    path: list[Vector] = [
        (0.02, 0.0, top + 0.03),
        (x, 0.0, top + 0.01),
        (x + 0.015, 0.0, top - 0.10),
        (x, 0.0, bottom + 0.14),
    ]
    horn = moved(cylinder(0.014, 0.0, 0.13, sides=8, top=0.026), (x, 0.0, bottom + 0.14), roll=3.1416)
    half = radius * 0.72
    front = -radius * 1.004
    label = [
        quad([(-half * 0.5, front, bottom + 0.14), (half * 0.5, front, bottom + 0.14),
              (half * 0.5, front, bottom + 0.30), (-half * 0.5, front, bottom + 0.30)])
    ]  # fmt: skip
    plain = [AuthoredMesh(mesh.points, mesh.counts, mesh.indices) for mesh in label]
    pieces = [
        PropPiece(RED, bottle),
        PropPiece(STEEL, valve),
        *(PropPiece(BLACK, lever) for lever in levers),
        PropPiece(BRIGHT, gauge),
    ]
    pieces += [
        PropPiece(BLACK, tube(path, 0.011, 4)),
        PropPiece(BLACK, horn),
        *(PropPiece(BRIGHT, mesh) for mesh in plain),
    ]
    return [*pieces, *_mount(kind, radius, bottom, top)]


def _mount(kind: int, radius: float, bottom: float, top: float) -> list[PropPiece]:
    """Mount of the bottle: a floor stand with a pole, a wall plate, or wheels."""
    if kind == 0:
        tray = lathe([(0.13, 0.0), (0.13, 0.02), (0.10, 0.05)], sides=12)
        pole = rod((0.0, radius + 0.02, 0.02), (0.0, radius + 0.02, 0.95), 0.012)
        face = [(-0.11, radius, 0.80), (0.11, radius, 0.80), (0.11, radius, 1.02), (-0.11, radius, 1.02)]
        sign = block((-0.12, radius + 0.002, 0.79), (0.12, radius + 0.03, 1.03))
        return [PropPiece(BLACK, tray), PropPiece(STEEL, pole), PropPiece(RED, sign), PropPiece(_sign(), quad(face))]
    if kind == 1:
        return [PropPiece(BRIGHT, block((-0.03, radius, bottom + 0.04), (0.03, radius + 0.02, top + 0.02)))]
    meshes = [moved(cylinder(0.05, -0.015, 0.015, sides=10), (x, 0.06, 0.05), pitch=1.5708) for x in (-0.13, 0.13)]
    handle = tube([(-0.06, 0.11, 0.1), (-0.06, 0.13, 0.85), (0.06, 0.13, 0.85), (0.06, 0.11, 0.1)], 0.011, 5)
    axle = rod((-0.13, 0.06, 0.05), (0.13, 0.06, 0.05), 0.012)
    return [*(PropPiece(BLACK, mesh) for mesh in meshes), PropPiece(STEEL, handle), PropPiece(STEEL, axle)]


def _sign() -> SurfaceMaterial:
    return SurfaceMaterial("SignFire", "#c3211d", "SignFire", roughness=0.4)


def whiteboard(variant: int, _rng: Generator) -> list[PropPiece]:
    """A board with frame, pen tray and scribbles: wall-hung in two sizes, or mobile on castors."""
    kind = variant % 3
    half, low, high = ((0.80, 0.85, 1.85), (0.60, 0.75, 1.75), (0.65, 0.70, 1.75))[kind]
    back = 0.0 if kind == 2 else 0.02
    panel = block((-half, -0.012 + back, low), (half, 0.012 + back, high))
    front = -0.0135 + back
    writing = quad([(-half, front, low), (half, front, low), (half, front, high), (-half, front, high)])
    bars = [
        block((-half - 0.02, front - 0.008, low - 0.02), (half + 0.02, back + 0.02, low)),
        block((-half - 0.02, front - 0.008, high), (half + 0.02, back + 0.02, high + 0.02)),
        block((-half - 0.02, front - 0.008, low), (-half, back + 0.02, high)),
        block((half, front - 0.008, low), (half + 0.02, back + 0.02, high)),
        block((-half * 0.6, front - 0.07, low - 0.02), (half * 0.6, front, low - 0.005)),
    ]
    pens = [
        PropPiece(
            painted(paint),
            rod((x, front - 0.04, low + 0.003), (x + 0.12, front - 0.04, low + 0.003), 0.009, 5),
        )
        for paint, x in (("Red", -0.3), ("Blue", -0.1), ("Green", 0.12))
    ]
    frame = (STEEL, BLACK, STEEL)[kind]
    pieces = [PropPiece(BRIGHT, panel), PropPiece(SCRIBBLES, writing), *(PropPiece(frame, bar) for bar in bars), *pens]
    return pieces if kind < 2 else [*pieces, *_trestle(half, high)]


def _trestle(half: float, high: float) -> list[PropPiece]:
    """Two T-feet on castors for a mobile board."""
    pieces: list[PropPiece] = []
    for x in (-half, half):
        pieces.append(PropPiece(STEEL, block((x - 0.02, -0.015, 0.06), (x + 0.02, 0.03, high - 0.005))))
        pieces.append(PropPiece(STEEL, cushion((x - 0.025, -0.27, 0.05), (x + 0.025, 0.27, 0.09), 0.01)))
        for y in (-0.24, 0.24):
            pieces.append(PropPiece(BLACK, moved(cylinder(0.03, -0.015, 0.015, sides=8), (x, y, 0.03), pitch=1.5708)))
    pieces.append(PropPiece(STEEL, rod((-half, 0.0, 0.3), (half, 0.0, 0.3), 0.014)))
    return pieces
