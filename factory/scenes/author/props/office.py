"""Builders of tables, desks, monitors, plants and waste bins: metres, origin on the floor, front (user side) at -y.

Desk frames leave the knee space open for a low robot. Does not place props.
"""

from __future__ import annotations

import math

from numpy.random import Generator

from factory.scenes.author.geometry import (
    AuthoredMesh,
    Vector,
    block,
    card,
    cushion,
    cylinder,
    fitted_block,
    lathe,
    moved,
    pad,
    quad,
    rod,
    standing_block,
    tube,
    uncapped,
)  # fmt: skip
from factory.scenes.author.materials import PropPiece, SurfaceMaterial, glowing, painted, textured

BLACK = painted("Black", 0.5)
CHARCOAL = painted("Charcoal", 0.5)
WHITE = painted("White", 0.45)
STEEL = painted("Steel", 0.35, 1.0)
WOODS = (
    textured("WoodOak", "#c39a66", 0.9),
    textured("WoodWalnut", "#7a5233", 0.9),
    WHITE,
    textured("WoodPale", "#d9c19a", 0.9),
)
SCREENS = tuple(
    glowing(name, colour, name, 0.85)
    for name, colour in (("ScreenCode", "#1b2838"), ("ScreenDesktop", "#6aa3dc"), ("ScreenChart", "#e6e9ec"))
)


def _end_frames(half_x: float, half_y: float, height: float, metal: SurfaceMaterial) -> list[PropPiece]:
    """Two slim steel portals, one under each short end."""
    meshes: list[AuthoredMesh] = []
    for x in (-half_x, half_x):
        for y in (-half_y, half_y):
            meshes.append(block((x - 0.025, y - 0.025, 0.0), (x + 0.025, y + 0.025, height)))
        meshes.append(block((x - 0.02, -half_y, height - 0.06), (x + 0.02, half_y, height - 0.01)))
    meshes.append(block((-half_x, half_y - 0.02, height - 0.07), (half_x, half_y + 0.01, height - 0.02)))
    return [PropPiece(metal, mesh) for mesh in meshes]


def desk(variant: int, rng: Generator) -> list[PropPiece]:
    """A white or wooden work desk 1.3-1.5 m wide on an open frame; some variants have drawers under the top."""
    half_x, half_y = (0.70, 0.35) if variant % 2 == 0 else (0.65, 0.34)
    board = WOODS[variant % 4]
    metal = WHITE if board is WHITE else (BLACK, WHITE, STEEL)[variant % 3]
    top = block((-half_x, -half_y, 0.715), (half_x, half_y, 0.745))
    pieces = [PropPiece(board, top), *_end_frames(half_x - 0.05, half_y - 0.05, 0.715, metal)]
    if variant % 4 < 2:  # slim drawers under the top: 0.62 m above the floor, so nothing catches a robot
        pieces.append(
            PropPiece(board, block((half_x - 0.5, -half_y + 0.03, 0.63), (half_x - 0.1, half_y - 0.1, 0.715)))
        )
    mug = cylinder(0.04, 0.745, 0.84, (-half_x + 0.14, -0.05), 10, top=0.045)
    cup = painted(("Red", "Yellow", "Teal", "White")[int(rng.integers(4))], 0.4)
    sheet_z, sheet_x = 0.748, -half_x + 0.33
    paper: list[Vector] = [
        (sheet_x - 0.1, -0.28, sheet_z), (sheet_x + 0.11, -0.26, sheet_z),
        (sheet_x + 0.09, 0.03, sheet_z), (sheet_x - 0.12, 0.01, sheet_z),
    ]  # fmt: skip
    return [*pieces, PropPiece(cup, mug), PropPiece(WHITE, card(paper))]


def meeting_table(variant: int, _rng: Generator) -> list[PropPiece]:
    """A boat-shaped conference table 1.9 m long on two pedestals."""
    wood = WOODS[(variant + 1) % 4]
    half_x, half_y = 0.95, 0.48
    top = cushion((-half_x, -half_y, 0.70), (half_x, half_y, 0.75), 0.02)
    hub = block((-0.12, -0.08, 0.745), (0.12, 0.08, 0.765))
    legs = [block((x - 0.05, -0.05, 0.02), (x + 0.05, 0.05, 0.70)) for x in (-0.5, 0.5)]
    feet = [block((x - 0.04, -0.32, 0.0), (x + 0.04, 0.32, 0.03)) for x in (-0.5, 0.5)]
    return [PropPiece(wood, top), PropPiece(CHARCOAL, hub), *(PropPiece(CHARCOAL, mesh) for mesh in (*legs, *feet))]


def round_table(variant: int, _rng: Generator) -> list[PropPiece]:
    """A round bistro table on a single column."""
    radius = (0.45, 0.50, 0.40)[variant % 3]
    top = lathe([(radius - 0.01, 0.71), (radius, 0.72), (radius, 0.735), (radius - 0.01, 0.745)], sides=20)
    metal = (STEEL, BLACK)[variant % 2]
    foot = lathe([(0.25, 0.0), (0.25, 0.012), (0.045, 0.05), (0.035, 0.5), (0.06, 0.71)], sides=14)
    return [PropPiece(WOODS[(variant + 2) % 4], top), PropPiece(metal, foot)]


def coffee_table(variant: int, rng: Generator) -> list[PropPiece]:
    """A low lounge table with four splayed legs, round or square, with a magazine on it."""
    wood = WOODS[variant % 4]
    if variant % 2 == 0:
        top = cylinder(0.34, 0.40, 0.44, sides=18)
    else:
        top = pad((-0.38, -0.27, 0.38), (0.38, 0.27, 0.42), 0.01)
    z = 0.44 if variant % 2 == 0 else 0.42
    legs = [rod((x, y, z - 0.03), (x * 1.25, y * 1.25, 0.0), 0.018, 5) for x in (-0.2, 0.2) for y in (-0.15, 0.15)]
    magazine = block((-0.1, -0.12, z), (0.11, 0.14, z + 0.015))
    cover = painted(("Red", "SkyBlue", "Yellow")[int(rng.integers(3))], 0.3)
    return [PropPiece(wood, top), PropPiece(cover, magazine), *(PropPiece(BLACK, leg) for leg in legs)]


def monitor(variant: int, _rng: Generator) -> list[PropPiece]:
    """A lit flat screen on a stand, its foot at z = 0 (the desk top); the screen faces -y."""
    case = (BLACK, WHITE, CHARCOAL)[variant % 3]
    half, height, lift = ((0.28, 0.34, 0.12), (0.31, 0.36, 0.14), (0.25, 0.31, 0.11))[variant % 3]
    body = cushion((-half, -0.02, lift), (half, 0.025, lift + height), 0.008)
    low, high = lift + 0.025, lift + height - 0.018
    left, right = -half + 0.016, half - 0.016
    screen = quad([(left, -0.0215, low), (right, -0.0215, low), (right, -0.0215, high), (left, -0.0215, high)])
    neck = block((-0.03, 0.025, 0.01), (0.03, 0.048, lift + 0.15))
    foot = standing_block((-0.12, -0.07, 0.0), (0.12, 0.10, 0.014))
    stand = STEEL if variant % 3 == 2 else case
    hump = pad((-half * 0.6, 0.02, lift + 0.06), (half * 0.6, 0.05, lift + height - 0.06), 0.012, is_loose=True)
    return [
        PropPiece(case, body),
        PropPiece(case, hump),
        PropPiece(SCREENS[variant % 3], screen),
        PropPiece(stand, neck),
        PropPiece(stand, foot),
    ]


def _broad_leaf(angle: float, tilt: float, length: float, width: float, at: Vector) -> AuthoredMesh:
    """A pointed leaf bent once, visible from both sides; `tilt` is its rise above the horizontal, radians."""
    half = [(0.35, 1.0, 0.02), (0.75, 0.7, 0.0)]
    right: list[Vector] = [(length * along, -width * out, rise) for along, out, rise in half]
    left: list[Vector] = [(length * along, width * out, rise) for along, out, rise in reversed(half)]
    outline: list[Vector] = [(0.0, 0.0, 0.0), *right, (length, 0.0, -0.05), *left]
    return moved(moved(card(outline), pitch=-tilt), at, yaw=angle)


def _pot(variant: int, radius: float, height: float) -> list[PropPiece]:
    clay = (
        painted("Terracotta", 0.8),
        painted("White", 0.4),
        painted("Charcoal", 0.7),
        painted("Navy", 0.4),
    )[variant % 4]
    wall = lathe(
        [(radius * 0.72, 0.0), (radius, height), (radius * 0.9, height), (radius * 0.88, height - 0.04)],
        sides=14,
    )
    return [
        PropPiece(clay, wall),
        PropPiece(painted("Soil", 1.0), cylinder(radius * 0.87, height - 0.05, height - 0.03, sides=12)),
    ]


def plant(variant: int, rng: Generator) -> list[PropPiece]:
    """A potted plant: rubber tree, fan of sword leaves, or palm, 0.8-1.4 m tall."""
    kind = variant % 3
    pieces = _pot(variant, (0.17, 0.16, 0.19)[kind], (0.30, 0.34, 0.28)[kind])
    green = painted("DarkLeaf" if kind == 0 else "Leaf", 0.5)
    base = (0.28, 0.32, 0.26)[kind]
    leaves: list[AuthoredMesh] = []
    if kind == 0:  # leaves in a spiral up the stem
        pieces.append(
            PropPiece(painted("Brown", 0.9), tube([(0, 0, base), (0.02, 0.01, 0.75), (0.0, 0.0, 1.2)], 0.016, 5))
        )
        for step in range(26):
            z = 0.48 + 0.03 * step
            length = float(rng.uniform(0.20, 0.30)) * (1.15 - 0.35 * (z - 0.48) / 0.78)
            leaves.append(
                _broad_leaf(step * 2.4, float(rng.uniform(0.1, 0.7)), length=length, width=0.055, at=(0.0, 0.0, z))
            )
    elif kind == 1:  # sword leaves from the soil
        for step in range(18):
            angle, reach = step * 2.4, 0.02 + 0.05 * float(rng.random())
            foot = (reach * math.cos(angle), reach * math.sin(angle), base)
            leaves.append(
                _broad_leaf(
                    angle, float(rng.uniform(1.15, 1.5)), length=float(rng.uniform(0.4, 0.7)), width=0.04, at=foot
                )
            )
    else:  # arching fronds
        pieces.append(PropPiece(painted("Brown", 0.9), cylinder(0.035, base, 0.7, sides=7, top=0.02)))
        for step in range(11):
            angle, rise = step * 2.4, float(rng.uniform(0.4, 1.1))
            leaves.extend(_frond(angle, rise, 0.62, (0.0, 0.0, 0.68)))
    return [*pieces, *(PropPiece(green, leaf) for leaf in leaves)]


def _frond(angle: float, rise: float, length: float, at: Vector) -> list[AuthoredMesh]:
    """A palm frond of two bent segments with a drooping tip."""
    middle, width = length * 0.5, 0.05
    z1, z2 = middle * math.tan(min(rise, 1.0)), middle * math.tan(min(rise, 1.0)) * 1.1 - 0.06
    inner: list[Vector] = [(0.0, -0.01, 0.0), (middle, -width, z1), (middle, width, z1), (0.0, 0.01, 0.0)]
    outer: list[Vector] = [(middle, -width, z1), (length * 0.85, 0.0, z2), (middle, width, z1)]
    scale = 0.62
    return [
        moved(card([(x * scale, y, z * scale) for x, y, z in outline]), at, yaw=angle) for outline in (inner, outer)
    ]


def trash_can(variant: int, _rng: Generator) -> list[PropPiece]:
    """An open paper bin, a pedal bin with a lid, a bin with a swing top, or a grey mesh office bin."""
    kind = variant % 4
    if kind == 0:
        rim = lathe([(0.12, 0.0), (0.16, 0.40), (0.165, 0.41), (0.15, 0.41), (0.12, 0.06)], sides=14)
        return [
            PropPiece(painted("Charcoal"), rim),
            PropPiece(WHITE, lathe([(0.14, 0.33), (0.05, 0.37)], sides=9)),
        ]
    if kind == 1:
        can = uncapped(lathe([(0.15, 0.0), (0.15, 0.03), (0.145, 0.03), (0.145, 0.50)], sides=16))
        lid = lathe([(0.15, 0.50), (0.15, 0.53), (0.10, 0.57), (0.02, 0.58)], sides=16)
        pedal = block((-0.05, -0.20, 0.02), (0.05, -0.13, 0.04))
        return [PropPiece(painted("Steel", 0.3, 1.0), can), PropPiece(BLACK, lid), PropPiece(BLACK, pedal)]
    if kind == 2:
        body = block((-0.17, -0.14, 0.0), (0.17, 0.14, 0.52))
        hood = cushion((-0.175, -0.145, 0.51), (0.175, 0.145, 0.64), 0.02)
        flap = quad([(-0.12, -0.1455, 0.55), (0.12, -0.1455, 0.55), (0.12, -0.1455, 0.615), (-0.12, -0.1455, 0.615)])
        paint = painted(("Green", "Blue", "Red")[variant // 4 % 3])
        return [
            PropPiece(paint, body),
            PropPiece(paint, hood),
            PropPiece(BLACK, AuthoredMesh(flap.points, flap.counts, flap.indices)),
        ]
    body = lathe(
        [(0.20, 0.0), (0.22, 0.62), (0.235, 0.62), (0.235, 0.66), (0.16, 0.70), (0.12, 0.70), (0.12, 0.62)],
        sides=14,
    )
    return [
        PropPiece(painted(("Blue", "Grey", "Yellow")[variant // 4 % 3]), body),
        PropPiece(BLACK, cylinder(0.11, 0.60, 0.64, sides=12)),
    ]


def keys_pad(_variant: int, _rng: Generator) -> list[PropPiece]:
    """A keyboard and a mouse on a desk top at z = 0."""
    keys = SurfaceMaterial("Keys", "#2c2f34", "Keys")
    board = fitted_block((-0.22, -0.07, 0.0), (0.22, 0.07, 0.022))
    return [PropPiece(keys, board), PropPiece(BLACK, pad((0.28, -0.05, 0.0), (0.34, 0.05, 0.03), 0.012))]
