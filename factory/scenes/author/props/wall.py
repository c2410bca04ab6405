"""Builders of wall-mounted props that are not targets: posters, notices, signs, screens, clocks, windows, doors.

Lengths in metres, wall plane at y = 0, front facing -y. The mesh includes the mounting height. Does not place props.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.random import Generator

from factory.scenes.author.geometry import block, cylinder, moved, quad
from factory.scenes.author.materials import PropPiece, SurfaceMaterial, glowing, painted, textured, wood

BLACK = painted("Black", 0.5)
WHITE = painted("White", 0.45)
STEEL = painted("Steel", 0.35, 1.0)
POSTERS = tuple(
    SurfaceMaterial(name, "#dcd2c0", name, roughness=0.4)
    for name in (
        "PosterSun", "PosterBlocks", "NoticeBlue", "PosterHills", "PosterArcs", "NoticeGreen",
        "PosterCity", "PosterType", "NoticePlan",
    )
)  # fmt: skip


def _picture(
    art: SurfaceMaterial, frame: SurfaceMaterial, low: tuple[float, float], high: tuple[float, float]
) -> list[PropPiece]:
    """A framed rectangle between two (x, z) corners, 3 cm off the wall."""
    (x0, z0), (x1, z1) = low, high
    border = block((x0 - 0.025, -0.03, z0 - 0.025), (x1 + 0.025, 0.0, z1 + 0.025))
    return [
        PropPiece(frame, border),
        PropPiece(art, quad([(x0, -0.0315, z0), (x1, -0.0315, z0), (x1, -0.0315, z1), (x0, -0.0315, z1)])),
    ]


def poster(variant: int, _rng: Generator) -> list[PropPiece]:
    """A framed picture or a notice at eye height."""
    frame = (BLACK, WHITE, STEEL)[variant % 3]
    wide = (0.45, 0.35, 0.30)[variant % 3]
    return _picture(POSTERS[variant % 9], frame, (-wide, 1.15), (wide, 1.15 + 2.0 * wide))


def safety_notice(variant: int, _rng: Generator) -> list[PropPiece]:
    """A green safety placard or a red fire sign."""
    names = (("NoticeSafety", "#1e7d4f"), ("SignFire", "#c3211d"), ("SignAisle", "#234a86"))
    name, colour = names[variant % 3]
    half = (0.45, 0.17, 0.4)[variant % 3]
    return _picture(SurfaceMaterial(name, colour, name, roughness=0.4), WHITE, (-half, 1.35), (half, 1.35 + 1.5 * half))


def hanging_sign(variant: int, _rng: Generator) -> list[PropPiece]:
    """A lit sign hung flat above a door at 2.2-2.5 m."""
    name, colour = (("SignExit", "#1b8a4a"), ("SignWard", "#2a6fb0"))[variant % 2]
    half = (0.24, 0.30)[variant % 2]
    return _picture(glowing(name, colour, name, 0.5), BLACK, (-half, 2.16), (half, 2.40))


def wall_screen(variant: int, _rng: Generator) -> list[PropPiece]:
    """A large flat television on the wall."""
    name, colour = (("ScreenChart", "#e6e9ec"), ("ScreenDesktop", "#6aa3dc"))[variant % 2]
    art = glowing(name, colour, name, 0.85)
    return _picture(art, BLACK, (-0.65, 1.05), (0.65, 1.80))


def clock(_variant: int, _rng: Generator) -> list[PropPiece]:
    """A round wall clock."""
    rim = moved(cylinder(0.16, 0.0, 0.035, sides=20), (0.0, 0.0, 2.1), roll=1.5708)
    face = moved(cylinder(0.145, 0.0, 0.038, sides=20), (0.0, 0.0, 2.1), roll=1.5708)
    hands = [
        block((-0.006, -0.041, 2.1), (0.006, -0.039, 2.2)),
        block((0.0, -0.041, 2.095), (0.08, -0.039, 2.105)),
    ]
    return [PropPiece(BLACK, rim), PropPiece(WHITE, face), *(PropPiece(BLACK, hand) for hand in hands)]


def window(variant: int, _rng: Generator) -> list[PropPiece]:
    """A bright two-pane window with frame and sill: 1.6 m wide, or a warehouse strip above 3.6 m."""
    view = glowing("WindowView", "#cfe2f2", "WindowView", 0.9)
    half, low, high = ((0.8, 0.85, 2.2), (0.55, 0.85, 2.2), (1.5, 3.8, 5.0))[variant % 3]
    frame = WHITE if variant % 3 < 2 else STEEL
    bars = [block((x - 0.03, -0.06, low), (x + 0.03, 0.0, high)) for x in (-half, 0.0, half)]
    bars += [block((-half - 0.03, -0.06, z - 0.03), (half + 0.03, 0.0, z + 0.03)) for z in (low, high)]
    sill = block((-half - 0.08, -0.14, low - 0.05), (half + 0.08, 0.0, low - 0.02))
    panes = quad([(-half, -0.02, low), (half, -0.02, low), (half, -0.02, high), (-half, -0.02, high)])
    return [PropPiece(view, panes), *(PropPiece(frame, bar) for bar in bars), PropPiece(WHITE, sill)]


def roller_door(_variant: int, _rng: Generator) -> list[PropPiece]:
    """A closed loading gate 3 m wide with hazard-striped jambs and rubber bumpers."""
    curtain = block((-1.5, -0.05, 0.0), (1.5, 0.0, 3.2))
    stripes = textured("Hazard", "#d8ac20", 0.6, 0.7)
    jambs = [block((x - 0.12, -0.14, 0.0), (x + 0.12, 0.0, 3.2)) for x in (-1.62, 1.62)]
    box = block((-1.74, -0.40, 3.2), (1.74, 0.0, 3.75))
    bumpers = [block((x - 0.12, -0.16, 0.05), (x + 0.12, -0.05, 0.5)) for x in (-1.1, 1.1)]
    return [
        PropPiece(textured("RollerDoor", "#9aa6ae", 1.0), moved(curtain)),
        *(PropPiece(stripes, jamb) for jamb in jambs),
        PropPiece(STEEL, box),
        *(PropPiece(BLACK, bumper) for bumper in bumpers),
    ]


PICTURES = (
    ("PictureAbstract", 0.40, 0.40), ("PictureStillLife", 0.30, 0.38), ("PictureLake", 0.55, 0.38),
    ("PosterHills", 0.50, 0.40), ("PosterCity", 0.34, 0.46), ("PosterArcs", 0.40, 0.40),
    ("PicturePortrait", 0.28, 0.36), ("PictureBoats", 0.50, 0.36), ("PictureBotany", 0.26, 0.38),
    ("PictureBands", 0.36, 0.52), ("PictureCircles", 0.42, 0.42), ("PictureBirches", 0.48, 0.48),
    ("PictureCat", 0.24, 0.30), ("PosterType", 0.34, 0.46),
)  # fmt: skip
"""Texture, half width and half height of each painting, metres."""
OUTLOOKS = (
    "ViewGarden", "ViewSuburb", "ViewHills", "ViewSea", "ViewStreet", "WindowView", "ViewWoods", "ViewSnow",
    "ViewTowers", "ViewPark", "ViewDesert", "ViewHarbour", "ViewVillage",
)  # fmt: skip
"""Textures of the views from windows."""
_HORIZON = 0.42
"""Height of the horizon in a view, as a share of the side of the square texture."""


def framed_picture(variant: int, _rng: Generator) -> list[PropPiece]:
    """A painting at eye height; the wall plane is y = 0."""
    name, wide, tall = PICTURES[variant % len(PICTURES)]
    frame = (BLACK, wood("Oak"), WHITE)[variant % 3]
    low, high = 1.50 - tall, 1.50 + tall
    border = block((-wide - 0.03, -0.03, low - 0.03), (wide + 0.03, 0.0, high + 0.03))
    art = quad([(-wide, -0.0315, low), (wide, -0.0315, low), (wide, -0.0315, high), (-wide, -0.0315, high)])
    return [PropPiece(frame, border), PropPiece(SurfaceMaterial(name, "#dcd2c0", name, roughness=0.5), art)]


def home_window(variant: int, _rng: Generator) -> list[PropPiece]:
    """A casement window with one of the views, 1.6 m wide, white or wooden."""
    name = OUTLOOKS[variant % len(OUTLOOKS)]
    view, frame = glowing(name, "#cfe2f2", name, 0.9), (WHITE, wood("Pale"))[variant // len(OUTLOOKS) % 2]
    half, low, high = 0.8, 0.9, 2.15
    bars = [block((x - 0.03, -0.06, low), (x + 0.03, 0.0, high)) for x in (-half, 0.0, half)]
    bars += [block((-half - 0.03, -0.061, z - 0.03), (half + 0.03, 0.0, z + 0.03)) for z in (low, high)]
    sill = block((-half - 0.08, -0.14, low - 0.05), (half + 0.08, 0.0, low - 0.031))
    panes = quad([(-half, -0.02, low), (half, -0.02, low), (half, -0.02, high), (-half, -0.02, high)])
    return [PropPiece(view, panes), *(PropPiece(frame, bar) for bar in (*bars, sill))]


def _outlook(variant: int, low: tuple[float, float], high: tuple[float, float]) -> PropPiece:
    """A lit pane between two (x, z) corners.

    It shows a part of a view that has the proportions of the pane, so the view is not stretched. The horizon is in the
    lower half of the pane.
    """
    name = OUTLOOKS[variant % len(OUTLOOKS)]
    (x0, z0), (x1, z1) = low, high
    share = min(1.0, (z1 - z0) / (x1 - x0))
    bottom = min(_HORIZON - 0.4 * share, 1.0 - share)
    pane = quad([(x0, -0.02, z0), (x1, -0.02, z0), (x1, -0.02, z1), (x0, -0.02, z1)])
    corners = np.array([(0.0, bottom), (1.0, bottom), (1.0, bottom + share), (0.0, bottom + share)])
    return PropPiece(glowing(name, "#cfe2f2", name, 0.9), replace(pane, st=corners))


def band_window(variant: int, _rng: Generator) -> list[PropPiece]:
    """A window of three panes with one of the views, 2.4 m wide, with a white or a dark metal frame."""
    frame = (WHITE, painted("Charcoal", 0.5))[variant // len(OUTLOOKS) % 2]
    half, low, high = 1.2, 0.85, 2.25
    bars = [block((x - 0.03, -0.06, low), (x + 0.03, 0.0, high)) for x in (-half, -half / 3, half / 3, half)]
    bars += [block((-half - 0.03, -0.061, z - 0.03), (half + 0.03, 0.0, z + 0.03)) for z in (low, high)]
    sill = block((-half - 0.06, -0.13, low - 0.05), (half + 0.06, 0.0, low - 0.031))
    return [_outlook(variant, (-half, low), (half, high)), *(PropPiece(frame, bar) for bar in (*bars, sill))]


def strip_window(variant: int, _rng: Generator) -> list[PropPiece]:
    """A strip of glass 3 m wide below the roof of a hall, 3.8 to 4.9 m high."""
    frame = (STEEL, painted("Charcoal", 0.5))[variant // len(OUTLOOKS) % 2]
    half, low, high = 1.5, 3.8, 4.9
    bars = [block((x - 0.03, -0.06, low), (x + 0.03, 0.0, high)) for x in (-half, -half / 3, half / 3, half)]
    bars += [block((-half - 0.03, -0.061, z - 0.03), (half + 0.03, 0.0, z + 0.03)) for z in (low, high)]
    return [_outlook(variant, (-half, low), (half, high)), *(PropPiece(frame, bar) for bar in bars)]


def entry_door(variant: int, _rng: Generator) -> list[PropPiece]:
    """A closed door to the outside, 1.7 m wide: two glazed leaves with one of the views, or two steel leaves."""
    half, top = 0.85, 2.2
    is_steel = variant % 3 == 2
    frame = (painted("Charcoal", 0.5), wood("Oak"), painted("Grey", 0.5))[variant % 3]
    posts = [block((x - 0.05, -0.07, 0.0), (x + 0.05, 0.0, top)) for x in (-half, half)]
    posts.append(block((-half - 0.05, -0.071, top), (half + 0.05, 0.0, top + 0.08)))
    middle = block((-0.05, -0.06, 0.0), (0.05, 0.0, top))
    foot = block((-half, -0.055, 0.0), (half, 0.0, 0.25))
    grips = [block((x - 0.015, -0.11, 0.85), (x + 0.015, -0.085, 1.35)) for x in (-0.12, 0.12)]
    plate = block((-half, -0.04, 0.25), (half, 0.0, top - 0.01))
    pane = (
        PropPiece(painted("LightGrey", 0.5), plate) if is_steel else _outlook(variant // 3, (-half, 0.25), (half, top))
    )
    return [
        pane,
        *(PropPiece(frame, mesh) for mesh in (*posts, middle, foot)),
        *(PropPiece(STEEL, mesh) for mesh in grips),
    ]
