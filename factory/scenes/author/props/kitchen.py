"""Builders for kitchens: fitted units, sinks, ovens, dishwashers, refrigerators, small appliances, islands.

Units are 0.6 m wide and 0.90 m high, so they form a row. Lengths in metres, origin on the floor, front facing -y.
Does not place props.
"""

from __future__ import annotations

from numpy.random import Generator

from factory.scenes.author.geometry import block, cushion, cylinder, open_block, quad, tube
from factory.scenes.author.materials import PropPiece, SurfaceMaterial, painted, tinted, wood

WHITE = painted("White", 0.45)
BLACK = painted("Black", 0.35)
STEEL = painted("Steel", 0.35, 1.0)
CHROME = painted("Chrome", 0.25, 1.0)
FRONTS = (WHITE, wood("Oak"), painted("SkyBlue", 0.5), painted("LightGrey", 0.5))
TOPS = (
    wood("Oak"),
    tinted("Terrazzo", "TopGranite", colour="#8f8f8f", tile_m=0.5, roughness=0.3),
    wood("Walnut"),
    WHITE,
)
HALF, BACK, TOP_M = 0.30, 0.30, 0.90


def _unit(variant: int, width: float = 2 * HALF) -> list[PropPiece]:
    """Plinth, body and worktop of a unit."""
    half = width / 2
    plinth = block((-half, -BACK + 0.07, 0.0), (half, BACK, 0.10))
    body = block((-half, -BACK + 0.02, 0.10), (half, BACK, TOP_M - 0.04))
    top = block((-half, -BACK - 0.015, TOP_M - 0.04), (half, BACK, TOP_M))
    return [
        PropPiece(painted("Charcoal"), plinth),
        PropPiece(FRONTS[variant % 4], body),
        PropPiece(TOPS[variant % 4], top),
    ]


def _panel(material: SurfaceMaterial, low: tuple[float, float], high: tuple[float, float]) -> list[PropPiece]:
    """A front between two (x, z) corners, with a bar below its upper edge."""
    front = open_block((low[0] + 0.004, -BACK, low[1]), (high[0] - 0.004, -BACK + 0.02, high[1]), "SEWBT")
    middle = (low[0] + high[0]) / 2
    bar = open_block((middle - 0.09, -BACK - 0.025, high[1] - 0.06), (middle + 0.09, -BACK, high[1] - 0.045), "SEWBT")
    return [PropPiece(material, front), PropPiece(STEEL, bar)]


def base_unit(variant: int, _rng: Generator) -> list[PropPiece]:
    """A unit with a door, or with three drawers."""
    pieces, material = _unit(variant), FRONTS[variant % 4]
    if variant // 4 % 2 == 0:
        return [*pieces, *_panel(material, (-HALF, 0.11), (HALF, 0.85))]
    for z0, z1 in ((0.11, 0.38), (0.386, 0.62), (0.626, 0.85)):
        pieces += _panel(material, (-HALF, z0), (HALF, z1))
    return pieces


def wall_unit(variant: int, _rng: Generator) -> list[PropPiece]:
    """A hanging cupboard above a worktop, at 1.45 to 2.1 m."""
    material = FRONTS[variant % 4]
    body = block((-HALF, -0.02, 1.45), (HALF, 0.30, 2.10))
    fronts = [open_block((x0 + 0.004, -0.04, 1.455), (x0 + HALF - 0.004, -0.02, 2.095), "SEWBT") for x0 in (-HALF, 0.0)]
    return [PropPiece(material, body), *(PropPiece(material, front) for front in fronts)]


def splash_back(variant: int, _rng: Generator) -> list[PropPiece]:
    """Wall tiles between worktop and wall units, 0.6 m wide; the wall plane is y = 0."""
    tint = ("#e8ece8", "#9fb8b4", "#d8c7a8", "#b9c4d2")[variant % 4]
    plate = open_block((-HALF, -0.012, 0.92), (HALF, 0.0, 1.45), "SEWBT")
    return [PropPiece(tinted("SmallTiles", f"Splash{variant % 4}", colour=tint, tile_m=0.8, roughness=0.3), plate)]


def sink_unit(variant: int, _rng: Generator) -> list[PropPiece]:
    """A unit 0.8 m wide with a steel bowl and a tap."""
    pieces = _unit(variant, 0.8)
    for x0, x1 in ((-0.40, 0.0), (0.0, 0.40)):
        pieces += _panel(FRONTS[variant % 4], (x0, 0.11), (x1, 0.85))
    rim = open_block((-0.34, -0.22, TOP_M), (0.34, 0.20, TOP_M + 0.012), "SENWT")
    bowl = quad(
        [
            (-0.28, -0.17, TOP_M + 0.015),
            (0.06, -0.17, TOP_M + 0.015),
            (0.06, 0.13, TOP_M + 0.015),
            (-0.28, 0.13, TOP_M + 0.015),
        ]
    )
    tap = tube([(-0.11, 0.17, TOP_M), (-0.11, 0.17, 1.20), (-0.11, 0.06, 1.23), (-0.11, -0.02, 1.16)], 0.014)
    return [*pieces, PropPiece(STEEL, rim), PropPiece(painted("Charcoal", 0.4), bowl), PropPiece(CHROME, tap)]


def oven(variant: int, _rng: Generator) -> list[PropPiece]:
    """A cooker with a hob, a glass door and knobs: white, steel or black."""
    case = (WHITE, painted("LightGrey", 0.4), BLACK)[variant % 3]
    body = block((-HALF, -BACK + 0.02, 0.05), (HALF, BACK, TOP_M - 0.02))
    hob = block((-HALF, -BACK, TOP_M - 0.02), (HALF, BACK, TOP_M))
    plates = [
        cylinder(r, TOP_M, TOP_M + 0.006, (x, y), 14)
        for r, x, y in ((0.10, -0.14, -0.12), (0.08, 0.14, -0.12), (0.08, -0.14, 0.13), (0.10, 0.14, 0.13))
    ]
    door = open_block((-0.28, -BACK, 0.18), (0.28, -BACK + 0.02, 0.70), "SEWBT")
    glass = open_block((-0.20, -BACK - 0.004, 0.28), (0.20, -BACK, 0.58), "SEWBT")
    bar = block((-0.22, -BACK - 0.04, 0.63), (0.22, -BACK - 0.005, 0.65))
    knobs = [
        open_block((x - 0.02, -BACK + 0.0, 0.77), (x + 0.02, -BACK + 0.02, 0.81), "SEWBT")
        for x in (-0.22, -0.11, 0.0, 0.11, 0.22)
    ]
    feet = block((-HALF + 0.04, -BACK + 0.06, 0.0), (HALF - 0.04, BACK - 0.02, 0.05))
    pan = cylinder(0.10, TOP_M + 0.006, TOP_M + 0.11, (-0.14, 0.13), 14)
    return [
        *(PropPiece(case, mesh) for mesh in (body, door)),
        PropPiece(painted("Charcoal", 0.2), hob),
        *(PropPiece(BLACK, mesh) for mesh in plates),
        PropPiece(painted("Charcoal", 0.15), glass),
        *(PropPiece(STEEL, mesh) for mesh in (bar, *knobs, pan)),
        PropPiece(painted("Charcoal"), feet),
    ]


def dishwasher(variant: int, _rng: Generator) -> list[PropPiece]:
    """A dishwasher below the worktop: front with a control strip and a bar."""
    finish = (WHITE, painted("LightGrey", 0.4), BLACK)[variant % 3]
    body = block((-HALF + 0.005, -BACK + 0.02, 0.08), (HALF - 0.005, BACK, 0.86))
    front = open_block((-HALF + 0.008, -BACK, 0.10), (HALF - 0.008, -BACK + 0.02, 0.74), "SEWBT")
    strip = open_block((-HALF + 0.008, -BACK, 0.745), (HALF - 0.008, -BACK + 0.02, 0.855), "SEWBT")
    panel = open_block((0.05, -BACK - 0.003, 0.78), (0.22, -BACK, 0.82), "SEWBT")
    bar = block((-0.22, -BACK - 0.035, 0.68), (0.22, -BACK - 0.005, 0.70))
    foot = block((-HALF + 0.03, -BACK + 0.07, 0.0), (HALF - 0.03, BACK, 0.08))
    return [
        *(PropPiece(finish, mesh) for mesh in (body, front, strip)),
        PropPiece(painted("Charcoal"), panel),
        PropPiece(STEEL, bar),
        PropPiece(painted("Charcoal"), foot),
        PropPiece(TOPS[variant % 3], block((-HALF, -BACK - 0.015, 0.86), (HALF, BACK, TOP_M))),
    ]


def refrigerator(variant: int, _rng: Generator) -> list[PropPiece]:
    """A refrigerator with a freezer: white, silver, red or black; 1.7 to 1.9 m high."""
    paint = (WHITE, painted("LightGrey", 0.4), painted("Red", 0.35), BLACK)[variant % 4]
    high, split = ((1.80, 0.68), (1.90, 0.75), (1.65, 1.18), (1.85, 0.70))[variant % 4]
    body = cushion((-0.31, -0.30, 0.03), (0.31, 0.33, high), 0.02)
    doors = [
        cushion((-0.305, -0.345, z0), (0.305, -0.30, z1), 0.012)
        for z0, z1 in ((0.06, split - 0.01), (split + 0.01, high - 0.01))
    ]
    grips = [
        block((0.235, -0.385, z0), (0.26, -0.345, z1))
        for z0, z1 in ((split - 0.32, split - 0.06), (split + 0.06, split + 0.36))
    ]
    foot = block((-0.28, -0.25, 0.0), (0.28, 0.30, 0.03))
    return [
        *(PropPiece(paint, mesh) for mesh in (body, *doors)),
        *(PropPiece(STEEL, grip) for grip in grips),
        PropPiece(painted("Charcoal"), foot),
    ]


def microwave(variant: int, _rng: Generator) -> list[PropPiece]:
    """A microwave oven; its foot is at z = 0."""
    case = (WHITE, painted("LightGrey", 0.4), painted("Red", 0.35))[variant % 3]
    body = block((-0.25, -0.17, 0.01), (0.25, 0.18, 0.29))
    glass = open_block((-0.225, -0.176, 0.05), (0.10, -0.17, 0.26), "SEWBT")
    panel = open_block((0.13, -0.174, 0.05), (0.235, -0.17, 0.26), "SEWBT")
    bar = block((0.098, -0.20, 0.06), (0.112, -0.177, 0.25))
    foot = block((-0.22, -0.14, 0.0), (0.22, 0.15, 0.01))
    return [
        PropPiece(case, body),
        PropPiece(painted("Charcoal", 0.2), glass),
        PropPiece(painted("Charcoal"), panel),
        PropPiece(STEEL, bar),
        PropPiece(BLACK, foot),
    ]


def coffee_machine(variant: int, _rng: Generator) -> list[PropPiece]:
    """A machine with a water tank, a spout and a cup; its foot is at z = 0."""
    case = painted(("Black", "Red", "LightGrey")[variant % 3], 0.35)
    back = cushion((-0.12, 0.0, 0.0), (0.12, 0.17, 0.36), 0.012)
    head = cushion((-0.12, -0.15, 0.24), (0.12, 0.02, 0.36), 0.012)
    tray = block((-0.11, -0.15, 0.0), (0.11, 0.0, 0.03))
    spout = block((-0.03, -0.10, 0.205), (0.03, -0.05, 0.245))
    cup = cylinder(0.032, 0.031, 0.10, (0.0, -0.08), 10)
    return [
        PropPiece(case, back),
        PropPiece(case, head),
        PropPiece(STEEL, tray),
        PropPiece(STEEL, spout),
        PropPiece(WHITE, cup),
    ]


def island(variant: int, _rng: Generator) -> list[PropPiece]:
    """A free-standing counter 1.2 to 1.5 m long with a worktop on both sides."""
    half = (0.60, 0.75, 0.65)[variant % 3]
    body = block((-half + 0.05, -0.28, 0.06), (half - 0.05, 0.28, 0.88))
    foot = block((-half + 0.08, -0.24, 0.0), (half - 0.08, 0.24, 0.06))
    top = block((-half, -0.36, 0.88), (half, 0.36, 0.92))
    panels = [
        open_block((x + 0.01, -0.292, 0.12), (x + half - 0.06, -0.28, 0.82), "SEWBT") for x in (-half + 0.05, 0.0)
    ]
    board = block((-0.2, -0.12, 0.92), (0.12, 0.10, 0.94))
    return [
        PropPiece(FRONTS[variant % 3], body),
        PropPiece(painted("Charcoal"), foot),
        PropPiece(TOPS[(variant + 2) % 4], top),
        *(PropPiece(FRONTS[variant % 3], panel) for panel in panels),
        PropPiece(wood("Pale"), board),
    ]
