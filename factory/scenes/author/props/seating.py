"""Builders of chairs, stools and sofas: metres, origin on the floor, front facing -y.

Does not place props.
"""

from __future__ import annotations

import math

from numpy.random import Generator

from factory.scenes.author.geometry import AuthoredMesh, Vector, block, cushion, cylinder, moved, pad, rod, tube
from factory.scenes.author.materials import PropPiece, SurfaceMaterial, painted, textured

BLACK = painted("Black")
CHROME = painted("Chrome", 0.25, 1.0)
STEEL = painted("Steel", 0.35, 1.0)
OAK = textured("WoodOak", "#c39a66", 0.8)
WALNUT = textured("WoodWalnut", "#7a5233", 0.8)
PALE = textured("WoodPale", "#d9c19a", 0.8)
FABRICS = (
    textured("FabricBlue", "#2f5597", 0.5, 0.9),
    painted("Black", 0.9),
    textured("FabricGrey", "#7b7d80", 0.5, 0.9),
    textured("FabricRed", "#a32a26", 0.5, 0.9),
    textured("FabricGreen", "#3f7d4a", 0.5, 0.9),
)
SHELLS = tuple(painted(paint, 0.45) for paint in ("Orange", "Green", "White", "Navy", "Yellow"))
LEATHERS = (
    textured("FabricGrey", "#7b7d80", 0.5, 0.9),
    painted("Brown", 0.4),
    textured("FabricBlue", "#2f5597", 0.5, 0.9),
    textured("FabricRed", "#a32a26", 0.5, 0.9),
    painted("Beige", 0.8),
    textured("FabricGreen", "#3f7d4a", 0.5, 0.9),
)


def _fabric(variant: int) -> SurfaceMaterial:
    return FABRICS[variant % len(FABRICS)]


def _star_base(material: SurfaceMaterial, radius: float = 0.29) -> list[PropPiece]:
    """Five spokes with castors under a gas column."""
    meshes: list[AuthoredMesh] = [cylinder(0.03, 0.07, 0.43, sides=8), cylinder(0.06, 0.38, 0.43, sides=8, top=0.09)]
    wheels: list[AuthoredMesh] = []
    for spoke in range(5):
        angle = math.pi / 2 + spoke * 2 * math.pi / 5
        x, y = radius * math.cos(angle), radius * math.sin(angle)
        meshes.append(tube([(0.0, 0.0, 0.12), (0.6 * x, 0.6 * y, 0.10), (x, y, 0.07)], 0.022, 4))
        wheel = moved(cylinder(0.028, -0.022, 0.022, sides=6), roll=math.pi / 2)
        wheels.append(moved(wheel, (x, y, 0.028), yaw=angle))
    return [*(PropPiece(material, mesh) for mesh in meshes), *(PropPiece(BLACK, wheel) for wheel in wheels)]


def _arm_rests(material: SurfaceMaterial, half_width: float) -> list[PropPiece]:
    pieces: list[PropPiece] = []
    for side in (-half_width, half_width):
        frame: list[Vector] = [(side, 0.08, 0.47), (side * 1.12, 0.08, 0.5), (side * 1.12, 0.04, 0.66)]
        pieces.append(PropPiece(material, tube(frame, 0.018, 4)))
        rest = pad((-0.03, -0.16, 0.65), (0.03, 0.12, 0.685), 0.01)
        pieces.append(PropPiece(BLACK, moved(rest, (side * 1.12, 0.0, 0.0))))
    return pieces


def task_chair(variant: int, _rng: Generator) -> list[PropPiece]:
    """A swivel chair on five castors with a bowed fabric back."""
    fabric = _fabric(variant)
    back = [moved(cushion((-0.22, 0.0, 0.0), (0.22, 0.06, 0.24), 0.02), (0.0, 0.20, 0.58), roll=-0.02)]
    back.append(moved(cushion((-0.20, 0.0, 0.0), (0.20, 0.055, 0.24), 0.02), (0.0, 0.205, 0.81), roll=-0.22))
    spine = tube([(0.0, 0.05, 0.42), (0.0, 0.26, 0.44), (0.0, 0.285, 0.75)], 0.025, 4)
    seat = cushion((-0.24, -0.25, 0.44), (0.24, 0.22, 0.52), 0.035)
    arms = _arm_rests(BLACK, 0.24) if variant % 2 == 0 else []
    solid = [PropPiece(fabric, mesh) for mesh in (seat, *back)]
    return [*_star_base(BLACK), PropPiece(BLACK, spine), *solid, *arms]


def executive_chair(variant: int, _rng: Generator) -> list[PropPiece]:
    """A high-backed, thickly padded swivel chair with a chromed base."""
    leather = (painted("Black", 0.35), painted("Brown", 0.35), painted("DarkRed", 0.35))[variant % 3]
    seat = cushion((-0.27, -0.26, 0.43), (0.27, 0.24, 0.55), 0.05)
    lower = moved(cushion((-0.26, 0.0, 0.0), (0.26, 0.11, 0.36), 0.045), (0.0, 0.17, 0.54), roll=-0.1)
    upper = moved(cushion((-0.22, 0.0, 0.0), (0.22, 0.10, 0.32), 0.045), (0.0, 0.205, 0.88), roll=-0.16)
    solid = [PropPiece(leather, mesh) for mesh in (seat, lower, upper)]
    return [*_star_base(CHROME, 0.3), *solid, *_arm_rests(CHROME, 0.26)]


def cantilever_chair(variant: int, _rng: Generator) -> list[PropPiece]:
    """A visitor chair on a bent steel tube, seat and back in fabric."""
    fabric = _fabric(variant + 2)
    pieces: list[PropPiece] = []
    for side in (-0.23, 0.23):
        path: list[Vector] = [(side, 0.20, 0.02), (side, -0.22, 0.02), (side, -0.24, 0.06), (side, -0.21, 0.43),
                              (side, 0.16, 0.44), (side, 0.21, 0.50), (side, 0.27, 0.88)]  # fmt: skip
        pieces.append(PropPiece(CHROME, tube(path, 0.013, 4)))
    pieces.append(PropPiece(CHROME, rod((-0.23, 0.20, 0.02), (0.23, 0.20, 0.02), 0.013, 4)))
    seat = pad((-0.23, -0.22, 0.44), (0.23, 0.19, 0.49), 0.02)
    back = moved(pad((-0.22, -0.02, 0.0), (0.22, 0.02, 0.28), 0.015, is_loose=True), (0.0, 0.235, 0.60), roll=-0.15)
    return [*pieces, PropPiece(fabric, seat), PropPiece(fabric, back)]


def wooden_chair(variant: int, _rng: Generator) -> list[PropPiece]:
    """A four-legged chair of solid wood with a slatted back."""
    wood = (OAK, WALNUT, PALE)[variant % 3]
    meshes = [cushion((-0.21, -0.21, 0.43), (0.21, 0.21, 0.47), 0.012)]
    for x in (-0.18, 0.18):
        meshes.append(tube([(x, -0.18, 0.43), (x * 1.08, -0.20, 0.0)], 0.022, 4))
        meshes.append(tube([(x * 1.05, 0.21, 0.0), (x, 0.18, 0.45), (x, 0.24, 0.90)], 0.022, 4))
        meshes.append(rod((x * 1.03, -0.19, 0.2), (x * 1.03, 0.195, 0.2), 0.012, 4))
    for height in (0.56, 0.69, 0.82):
        slat = block((-0.18, -0.008, 0.0), (0.18, 0.008, 0.085))
        meshes.append(moved(slat, (0.0, 0.185 + (height - 0.5) * 0.13, height), roll=-0.13))
    return [PropPiece(wood, mesh) for mesh in meshes]


def waiting_chair(variant: int, _rng: Generator) -> list[PropPiece]:
    """A moulded plastic shell on four splayed steel legs."""
    shell = SHELLS[variant % len(SHELLS)]
    seat = pad((-0.22, -0.22, 0.43), (0.22, 0.20, 0.465), 0.012)
    back = [moved(pad((-0.21, -0.014, 0.0), (0.21, 0.014, 0.26), 0.012, is_loose=True), (0.0, 0.205, 0.45), roll=-0.12)]
    back.append(
        moved(pad((-0.20, -0.014, 0.0), (0.20, 0.014, 0.17), 0.012, is_loose=True), (0.0, 0.235, 0.70), roll=-0.28)
    )
    lip = moved(pad((-0.21, -0.05, -0.02), (0.21, 0.0, 0.018), 0.01), (0.0, -0.20, 0.435), roll=0.4)
    legs = [rod((x, y, 0.43), (x * 1.35, y * 1.25, 0.0), 0.014, 4) for x in (-0.17, 0.17) for y in (-0.17, 0.17)]
    rails = [rod((x * 1.15, -0.195, 0.24), (x * 1.15, 0.195, 0.24), 0.009, 4) for x in (-0.18, 0.18)]
    return [*(PropPiece(shell, m) for m in (seat, lip, *back)), *(PropPiece(STEEL, m) for m in (*legs, *rails))]


def stool(variant: int, _rng: Generator) -> list[PropPiece]:
    """A low round stool on castors, as in clinics, or on four wooden legs."""
    if variant % 2 == 0:
        seat = cylinder(0.18, 0.46, 0.53, sides=16)
        return [
            *_star_base(CHROME, 0.24),
            PropPiece((painted("Teal"), painted("Black", 0.9))[variant // 2 % 2], seat),
        ]
    seat = cylinder(0.17, 0.44, 0.48, sides=14)
    legs = [rod((x, y, 0.44), (x * 1.5, y * 1.5, 0.0), 0.018, 5) for x in (-0.1, 0.1) for y in (-0.1, 0.1)]
    return [PropPiece(PALE, mesh) for mesh in (seat, *legs)]


def sofa(variant: int, rng: Generator) -> list[PropPiece]:
    """A two-seat sofa, at most 1.56 m long, so the robot can reach its ends."""
    cover = LEATHERS[variant % len(LEATHERS)]
    half, arm, height = ((0.78, 0.16, 0.60), (0.72, 0.10, 0.66), (0.76, 0.20, 0.56))[variant % 3]
    depth = 0.40
    meshes = [block((-half + arm * 0.5, -depth + 0.03, 0.12), (half - arm * 0.5, depth - 0.05, 0.30))]
    meshes.append(
        moved(cushion((-half + 0.04, -0.11, 0.0), (half - 0.04, 0.11, 0.56), 0.05), (0.0, 0.27, 0.25), roll=-0.1)
    )
    inner = half - arm
    for side in (-1, 1):
        low, high = (0.005, inner) if side > 0 else (-inner, -0.005)
        meshes.append(cushion((low, -depth, 0.29), (high, 0.20, 0.44), 0.035))
        pillow = cushion((low + 0.02, -0.07, 0.0), (high - 0.02, 0.07, 0.38), 0.05)
        meshes.append(moved(pillow, (0.0, 0.16, 0.43), roll=-0.2))
        edge = sorted((side * half, side * inner))
        meshes.append(cushion((edge[0], -depth + 0.01, 0.10), (edge[1], depth - 0.02, height), 0.035))
    legs = [cylinder(0.02, 0.0, 0.12, (x * (half - 0.1), y), 6) for x in (-1, 1) for y in (-0.33, 0.31)]
    accent = painted(("Yellow", "Teal", "Orange", "White")[int(rng.integers(4))], 0.9)
    throw = moved(cushion((-0.19, -0.06, -0.19), (0.19, 0.06, 0.19), 0.05), (-inner + 0.22, 0.03, 0.60), roll=-0.3)
    foot = OAK if variant % 2 == 0 else BLACK
    return [*(PropPiece(cover, m) for m in meshes), *(PropPiece(foot, m) for m in legs), PropPiece(accent, throw)]
