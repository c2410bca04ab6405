"""Builders for lounges: lamps, televisions, fireplaces, pianos, fans, radiators, clocks, vases, dining tables.

Lengths in metres, origin on the floor, front facing -y. Does not place props.
"""

from __future__ import annotations

import math

from numpy.random import Generator

from factory.scenes.author.geometry import (
    AuthoredMesh,
    block,
    card,
    cushion,
    cylinder,
    fitted_block,
    lathe,
    moved,
    open_block,
    quad,
    rod,
    tube,
)
from factory.scenes.author.materials import PropPiece, SurfaceMaterial, cloth, glowing, painted, tinted, wood

WHITE = painted("White", 0.45)
BLACK = painted("Black", 0.5)
BRASS = SurfaceMaterial("Brass", "#b08d4a", roughness=0.35, metallic=1.0)
STEEL = painted("Steel", 0.35, 1.0)
SHADE = glowing("LampCloth", "#fbf5ea", glow=0.8)
WOODS = (wood("Oak"), wood("Walnut"), WHITE, wood("Cherry"))
SCREENS = tuple(
    glowing(name, "#6aa3dc", name, 0.85)
    for name in ("ScreenMatch", "PictureLake", "ViewSea", "ScreenNews", "ViewWoods", "ViewTowers")
)


def floor_lamp(variant: int, _rng: Generator) -> list[PropPiece]:
    """A standing lamp: column with a drum shade, tripod, or an arched lamp."""
    metal = (BLACK, wood("Oak"), BRASS)[variant % 3]
    if variant % 3 == 1:
        legs = [rod((0.26 * math.cos(a), 0.26 * math.sin(a), 0.0), (0.0, 0.0, 1.25), 0.014, 5) for a in (0.5, 2.6, 4.7)]
        shade = lathe([(0.22, 1.20), (0.20, 1.52)], sides=16)
        return [*(PropPiece(metal, leg) for leg in legs), PropPiece(SHADE, shade)]
    foot = lathe([(0.15, 0.0), (0.15, 0.02), (0.015, 0.04), (0.012, 1.42)], sides=12)
    if variant % 3 == 0:
        return [PropPiece(metal, foot), PropPiece(SHADE, lathe([(0.20, 1.35), (0.14, 1.62)], sides=16))]
    arc = tube([(0.0, 0.0, 1.40), (0.0, -0.06, 1.60), (0.0, -0.22, 1.68), (0.0, -0.38, 1.62)], 0.012, 5)
    bell = lathe([(0.16, 1.44), (0.05, 1.62)], (0.0, -0.38), 14)
    return [PropPiece(metal, foot), PropPiece(metal, arc), PropPiece(SHADE, bell)]


def table_lamp(variant: int, _rng: Generator) -> list[PropPiece]:
    """A lamp with a ceramic foot; its foot is at z = 0."""
    foot = painted(("White", "Teal", "Terracotta", "Navy")[variant % 4], 0.3)
    body = lathe([(0.06, 0.0), (0.085, 0.05), (0.08, 0.14), (0.02, 0.20), (0.012, 0.26)], sides=12)
    return [PropPiece(foot, body), PropPiece(SHADE, lathe([(0.14, 0.22), (0.10, 0.42)], sides=14))]


def television(variant: int, _rng: Generator) -> list[PropPiece]:
    """A flat television on a stand foot, 1.0 to 1.3 m wide; its foot is at z = 0."""
    half, high = ((0.55, 0.66), (0.62, 0.74), (0.48, 0.58))[variant % 3]
    low = 0.06
    case = cushion((-half, -0.02, low), (half, 0.02, low + high), 0.008)
    screen = quad(
        [
            (-half + 0.015, -0.0215, low + 0.02),
            (half - 0.015, -0.0215, low + 0.02),
            (half - 0.015, -0.0215, low + high - 0.015),
            (-half + 0.015, -0.0215, low + high - 0.015),
        ]
    )
    feet = [block((x - 0.02, -0.11, 0.0), (x + 0.02, 0.11, 0.012)) for x in (-0.3, 0.3)]
    necks = [block((x - 0.012, -0.012, 0.012), (x + 0.012, 0.012, low + 0.03)) for x in (-0.3, 0.3)]
    return [
        PropPiece(BLACK, case),
        PropPiece(SCREENS[variant % 6], screen),
        *(PropPiece(STEEL, mesh) for mesh in (*feet, *necks)),
    ]


def fireplace(variant: int, _rng: Generator) -> list[PropPiece]:
    """A chimney piece with a dark hearth, logs and embers."""
    stone = (
        tinted("Bricks", "HearthBrick", colour="#b06a4c", tile_m=0.6, roughness=0.9),
        WHITE,
        tinted("SquareTiles", "HearthSlate", "#7c8084", 0.5),
    )[variant % 3]
    shelf = wood(("Oak", "Walnut", "Ebony")[variant % 3])
    sides = [block((x - 0.19, -0.20, 0.0), (x + 0.19, 0.20, 0.95)) for x in (-0.51, 0.51)]
    lintel = block((-0.32, -0.199, 0.70), (0.32, 0.20, 0.95))
    back = block((-0.32, 0.12, 0.0), (0.32, 0.199, 0.70))
    mantel = block((-0.78, -0.27, 0.95), (0.78, 0.20, 1.01))
    hearth = block((-0.32, -0.19, 0.0), (0.32, 0.12, 0.03))
    logs = [
        moved(cylinder(0.05, -0.2, 0.2, sides=8), (0.0, y, z), pitch=1.5708)
        for y, z in ((-0.07, 0.09), (0.05, 0.09), (-0.01, 0.17))
    ]
    embers = block((-0.19, -0.12, 0.03), (0.19, 0.10, 0.045))
    return [
        *(PropPiece(stone, mesh) for mesh in (*sides, lintel)),
        PropPiece(BLACK, back),
        PropPiece(painted("Charcoal"), hearth),
        PropPiece(shelf, mantel),
        *(PropPiece(painted("Brown", 0.9), log) for log in logs),
        PropPiece(glowing("Embers", "#e0701a", glow=0.6), embers),
    ]


def piano(variant: int, _rng: Generator) -> list[PropPiece]:
    """An upright piano with keys, music desk and pedals."""
    finish = (painted("Black", 0.25), wood("Walnut"), wood("Cherry"), WHITE)[variant % 4]
    meshes = [
        block((-0.74, 0.0, 0.02), (0.74, 0.30, 1.18)),
        block((-0.76, -0.02, 1.18), (0.76, 0.31, 1.21)),
        block((-0.74, -0.28, 0.60), (0.74, 0.0, 0.68)),
        *(block((x - 0.03, -0.28, 0.68), (x + 0.03, 0.0, 0.82)) for x in (-0.71, 0.71)),
        *(block((x - 0.03, -0.27, 0.02), (x + 0.03, -0.20, 0.60)) for x in (-0.69, 0.69)),
        moved(block((-0.35, -0.012, 0.0), (0.35, 0.012, 0.24)), (0.0, -0.05, 0.84), roll=-0.3),
    ]
    keys = open_block((-0.66, -0.27, 0.68), (0.66, -0.10, 0.705), "SEWT")
    black = [
        open_block((x, -0.20, 0.705), (x + 0.014, -0.10, 0.717), "SEWT")
        for step in range(36)
        if step % 7 not in (2, 6)
        for x in (-0.645 + step * 0.036,)
    ]
    pedals = [block((x - 0.02, -0.10, 0.05), (x + 0.02, 0.0, 0.065)) for x in (-0.1, 0.0, 0.1)]
    return [
        *(PropPiece(finish, mesh) for mesh in meshes),
        PropPiece(WHITE, keys),
        *(PropPiece(BLACK if variant % 4 else painted("Charcoal"), mesh) for mesh in black),
        *(PropPiece(BRASS, pedal) for pedal in pedals),
    ]


def fan(variant: int, _rng: Generator) -> list[PropPiece]:
    """A pedestal fan with a wire guard and four blades."""
    paint = painted(("White", "Black", "SkyBlue")[variant % 3], 0.4)
    top = (1.15, 1.0, 1.25)[variant % 3]
    pole = lathe([(0.19, 0.0), (0.19, 0.02), (0.02, 0.05), (0.016, top)], sides=14)
    motor = moved(cylinder(0.06, -0.05, 0.10, sides=10), (0.0, 0.0, top + 0.04), roll=1.5708)
    blades = []
    for step in range(4):
        angle = step * math.pi / 2 + 0.4
        blade = moved(
            card([(0.03, 0.0, -0.02), (0.17, -0.02, -0.06), (0.18, 0.02, 0.05), (0.03, 0.0, 0.02)]), pitch=angle
        )
        blades.append(moved(blade, (0.0, -0.12, top + 0.04)))
    rings = [
        tube(
            [(r * math.cos(a), y, top + 0.04 + r * math.sin(a)) for a in [k * math.pi / 8 for k in range(17)]], 0.005, 3
        )
        for r, y in ((0.20, -0.17), (0.21, -0.12), (0.11, -0.18), (0.20, -0.07))
    ]
    spokes = [
        rod((0.0, -0.18, top + 0.04), (0.2 * math.cos(a), -0.17, top + 0.04 + 0.2 * math.sin(a)), 0.004, 3)
        for a in [k * math.pi / 6 for k in range(12)]
    ]
    return [PropPiece(paint, mesh) for mesh in (pole, motor, *blades, *rings, *spokes)]


def radiator(variant: int, _rng: Generator) -> list[PropPiece]:
    """A column radiator below a window, with a valve."""
    paint = painted(("White", "LightGrey", "Charcoal")[variant % 3], 0.4)
    ribs, high = ((12, 0.62), (16, 0.55), (9, 0.80))[variant % 3]
    half = 0.04 * ribs
    meshes = [
        cushion((-half + 0.08 * k + 0.01, -0.05, 0.12), (-half + 0.08 * k + 0.07, 0.05, high), 0.015)
        for k in range(ribs)
    ]
    meshes += [rod((-half + 0.02, 0.0, z), (half - 0.02, 0.0, z), 0.02, 6) for z in (0.18, high - 0.06)]
    meshes += [block((x - 0.015, -0.02, 0.0), (x + 0.015, 0.02, 0.13)) for x in (-half + 0.12, half - 0.12)]
    valve = moved(cylinder(0.02, 0.0, 0.06, sides=8), (half - 0.03, 0.0, high - 0.06), pitch=1.5708)
    return [*(PropPiece(paint, mesh) for mesh in meshes), PropPiece(STEEL, valve)]


def tall_clock(variant: int, _rng: Generator) -> list[PropPiece]:
    """A long-case clock with a glazed pendulum."""
    finish = wood(("Walnut", "Cherry", "Oak")[variant % 3])
    meshes = [
        block((-0.24, -0.14, 0.0), (0.24, 0.14, 0.30)),
        block((-0.18, -0.11, 0.30), (0.18, 0.12, 1.35)),
        block((-0.23, -0.13, 1.35), (0.23, 0.13, 1.85)),
        block((-0.26, -0.15, 1.85), (0.26, 0.15, 1.90)),
    ]
    face = moved(cylinder(0.17, 0.0, 0.008, sides=20), (0.0, -0.13, 1.6), roll=1.5708)
    hands = [
        open_block((-0.006, -0.143, 1.59), (0.006, -0.139, 1.73), "SEWBT"),
        open_block((0.0, -0.143, 1.594), (0.10, -0.139, 1.606), "SEWBT"),
    ]
    glass = open_block((-0.11, -0.115, 0.42), (0.11, -0.11, 1.26), "SEWBT")
    bob = moved(cylinder(0.06, 0.0, 0.006, sides=14), (0.0, -0.115, 0.62), roll=1.5708)
    pole = open_block((-0.006, -0.119, 0.66), (0.006, -0.115, 1.2), "SEWBT")
    return [
        *(PropPiece(finish, mesh) for mesh in meshes),
        PropPiece(WHITE, face),
        *(PropPiece(BLACK, mesh) for mesh in hands),
        PropPiece(painted("Charcoal", 0.2), glass),
        PropPiece(BRASS, bob),
        PropPiece(BRASS, pole),
    ]


def vase(variant: int, rng: Generator) -> list[PropPiece]:
    """A floor vase with dry stems, 0.4 to 0.6 m high without them."""
    glaze = painted(("Blue", "White", "Terracotta", "Green")[variant % 4], 0.25)
    high = (0.50, 0.42, 0.60, 0.45)[variant % 4]
    belly = (0.15, 0.17, 0.13, 0.16)[variant % 4]
    body = lathe(
        [(0.09, 0.0), (belly, 0.4 * high), (0.8 * belly, 0.7 * high), (0.06, 0.9 * high), (0.08, high), (0.05, high)],
        sides=16,
    )
    stems: list[AuthoredMesh] = []
    for step in range(7):
        a, lean = step * 2.4, float(rng.uniform(0.03, 0.16))
        stems.append(
            rod(
                (0.0, 0.0, high - 0.05),
                (lean * math.cos(a), lean * math.sin(a), high + float(rng.uniform(0.2, 0.42))),
                0.005,
                3,
            )
        )
    return [PropPiece(glaze, body), *(PropPiece(painted("Brown", 0.9), stem) for stem in stems)]


def mirror(variant: int, _rng: Generator) -> list[PropPiece]:
    """A tall leaning mirror with a frame."""
    frame = (BLACK, wood("Oak"), BRASS)[variant % 3]
    half, high = ((0.30, 1.60), (0.35, 1.70), (0.28, 1.50))[variant % 3]
    plate = block((-half, -0.015, 0.0), (half, 0.015, high))
    glass = open_block((-half + 0.03, -0.019, 0.03), (half - 0.03, -0.015, high - 0.03), "SEWBT")
    tilt = -0.10
    return [
        PropPiece(frame, moved(plate, (0.0, -0.02, 0.003), roll=tilt)),
        PropPiece(
            SurfaceMaterial("MirrorGlass", "#c4d3da", roughness=0.05), moved(glass, (0.0, -0.02, 0.003), roll=tilt)
        ),
    ]


def dining_table(variant: int, _rng: Generator) -> list[PropPiece]:
    """A dining table for four to six on four legs."""
    finish = WOODS[variant % 4]
    half_x, half_y = ((0.80, 0.45), (0.90, 0.45), (0.60, 0.40), (0.70, 0.42))[variant % 4]
    top = cushion((-half_x, -half_y, 0.72), (half_x, half_y, 0.755), 0.008)
    legs = [
        block((x - 0.035, y - 0.035, 0.0), (x + 0.035, y + 0.035, 0.72))
        for x in (-half_x + 0.07, half_x - 0.07)
        for y in (-half_y + 0.07, half_y - 0.07)
    ]
    return [PropPiece(finish, mesh) for mesh in (top, *legs)]


def toy_pile(variant: int, rng: Generator) -> list[PropPiece]:
    """Toy blocks and a ball on the floor."""
    paints = ("Red", "Yellow", "Blue", "Green", "Orange")
    meshes = [
        moved(
            fitted_block((-0.05, -0.05, 0.0), (0.05, 0.05, 0.09 + 0.006 * k)),
            (float(rng.uniform(-0.22, 0.22)), float(rng.uniform(-0.2, 0.2)), 0.0),
            yaw=float(rng.uniform(0, 3)),
        )
        for k in range(4)
    ]
    ball = lathe([(0.02, 0.0), (0.10, 0.05), (0.12, 0.12), (0.10, 0.19), (0.02, 0.24)], (0.0, 0.0), 12)
    return [
        *(PropPiece(painted(paints[(k + variant) % 5]), mesh) for k, mesh in enumerate(meshes)),
        PropPiece(cloth("Red"), ball),
    ]
