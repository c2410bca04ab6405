"""Builders of industrial vehicles: metres, origin on the floor, front at -y. Does not place props."""

from __future__ import annotations

from numpy.random import Generator

from factory.scenes.author.geometry import block, cushion, cylinder, moved, rod, uncapped
from factory.scenes.author.materials import PropPiece, painted

_BLACK = painted("Black", 0.5)
_STEEL = painted("Steel", 0.4, 1.0)


def fork_lift(variant: int, _rng: Generator) -> list[PropPiece]:
    """A parked counterbalance truck: forks on a mast, driver's seat, overhead guard, counterweight."""
    paint = painted(("Yellow", "Orange", "Red")[variant % 3], 0.4)
    body = [
        cushion((-0.52, -0.35, 0.28), (0.52, 0.75, 0.72), 0.04),
        cushion((-0.54, 0.70, 0.24), (0.54, 1.20, 1.05), 0.08),
        block((-0.40, -0.62, 0.28), (0.40, -0.35, 0.50)),
    ]
    seat = [
        cushion((-0.24, 0.12, 0.72), (0.24, 0.58, 0.86), 0.03),
        cushion((-0.24, 0.52, 0.84), (0.24, 0.64, 1.30), 0.03),
    ]
    wheel_at = [(x, y, r) for x in (-0.47, 0.47) for y, r in ((-0.42, 0.30), (0.88, 0.26))]
    wheels = [moved(cylinder(r, -0.10, 0.10, sides=14), (x, y, r), pitch=1.5708) for x, y, r in wheel_at]
    guard = [
        uncapped(rod((x, y, 0.70), (x * 0.94, y + 0.06, 2.08), 0.03, 5)) for x in (-0.48, 0.48) for y in (-0.32, 0.72)
    ]
    bars = [block((-0.48, y, 2.06), (0.48, y + 0.05, 2.10)) for y in (-0.28, -0.02, 0.24, 0.50, 0.76)]
    bars += [block((x - 0.03, -0.28, 2.03), (x + 0.03, 0.81, 2.06)) for x in (-0.45, 0.45)]
    mast = [block((x - 0.05, -0.76, 0.06), (x + 0.05, -0.64, 2.05)) for x in (-0.34, 0.34)]
    mast += [block((-0.34, -0.74, z), (0.34, -0.67, z + 0.07)) for z in (0.55, 1.95)]
    carriage = [block((-0.48, -0.82, z), (0.48, -0.77, z + 0.10)) for z in (0.12, 0.48)]
    forks = [block((x - 0.06, -1.85, 0.05), (x + 0.06, -0.80, 0.10)) for x in (-0.25, 0.25)]
    forks += [block((x - 0.06, -0.86, 0.05), (x + 0.06, -0.82, 0.62)) for x in (-0.25, 0.25)]
    column = rod((0.0, -0.30, 0.70), (0.0, -0.10, 1.10), 0.03, 5)
    hand_wheel = moved(cylinder(0.17, -0.015, 0.015, sides=12), (0.0, -0.09, 1.12), roll=-0.5)
    return [
        *(PropPiece(paint, mesh) for mesh in body),
        *(PropPiece(_BLACK, mesh) for mesh in (*seat, *wheels, *guard, *bars, column, hand_wheel)),
        *(PropPiece(_STEEL, mesh) for mesh in (*mast, *carriage, *forks)),
    ]
