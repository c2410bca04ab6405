"""Layout of the family `home`: five to nine rooms, with or without a hall, with seeded sizes, doors, furniture and
style.

Chooses the rooms and the style. `home_rooms` furnishes the rooms.
"""

from __future__ import annotations

import math

from numpy.random import Generator

from factory.scenes.author.circulation import RoomSpec, no_hall, straight_hall
from factory.scenes.author.dwelling import BuildingLook, RoomLook, build_rooms
from factory.scenes.author.layouts.home_rooms import furnish_home
from factory.scenes.author.partition import Division, Doors, divide_floor
from factory.scenes.author.placement import FloorPlan, Rectangle
from factory.scenes.author.style import Palette, draw_palette

_OPEN = {
    frozenset(("living", "kitchen")): (1.6, 2.8),
    frozenset(("living", "dining")): (1.6, 2.6),
    frozenset(("dining", "kitchen")): (1.5, 2.4),
    frozenset(("living", "hall")): (1.3, 1.8),
    frozenset(("dining", "hall")): (1.3, 1.7),
}


def lay_out_home(plan: FloorPlan) -> None:
    """Builds the rooms of one storey, then furnishes them.

    Raises:
        WorldError: no division of the floor into the chosen rooms was found; another seed may have one.
    """
    palette = draw_palette(plan.rng)
    division = _divide(plan.rng)
    building = BuildingLook(
        _looks(palette),
        palette.trim,
        palette.leaf,
        palette.ceiling,
        palette.views,
        float(plan.rng.choice((2.5, 2.6, 2.75, 2.9))),
    )
    furnish_home(plan, build_rooms(plan, division, building), palette)


def _divide(rng: Generator) -> Division:
    """Chooses the rooms and the outline at random; half of the homes have a hall."""
    has_hall = bool(rng.random() < 0.5)
    specs = [
        RoomSpec("living", float(rng.uniform(30, 42)), 4.2, True),
        RoomSpec("kitchen", float(rng.uniform(16, 21)), 3.1, True),
        RoomSpec("bedroom", float(rng.uniform(18, 23)), 3.4),
        RoomSpec("bath", float(rng.uniform(10, 13)), 2.5),
        RoomSpec("bedroom", float(rng.uniform(16, 20)), 3.3),
    ]
    if rng.random() < 0.6:
        specs.append(RoomSpec("dining", float(rng.uniform(15, 20)), 3.2, True))
    if rng.random() < 0.6:
        specs.append(RoomSpec("study", float(rng.uniform(12.5, 16)), 2.9))
    if rng.random() < 0.5:
        specs.append(RoomSpec("laundry", float(rng.uniform(8.5, 11)), 2.3))
    if rng.random() < 0.35:
        specs.append(RoomSpec("bedroom", float(rng.uniform(15, 18)), 3.2))
    hall = float(rng.uniform(1.7, 2.3)) if has_hall else None
    area, ratio = sum(spec.area_m2 for spec in specs), float(rng.uniform(1.1, 1.6))
    width = math.sqrt(area * ratio)
    outline = Rectangle(0.0, 0.0, width, area / width + (hall or 0.0))
    doors = Doors(float(rng.uniform(1.0, 1.15)), _OPEN, float(rng.uniform(0.3, 1.0)))
    return divide_floor(rng, outline, specs, doors, straight_hall(hall) if hall else no_hall)


def _looks(palette: Palette) -> dict[str, RoomLook]:
    paints, curtain = palette.paints, palette.curtain
    return {
        "living": RoomLook(palette.boards, paints[0], 3, curtain),
        "dining": RoomLook(palette.boards, paints[1], 2, curtain),
        "kitchen": RoomLook(palette.stone, paints[2], 1),
        "bedroom": RoomLook(palette.pile, paints[3], 1, curtain + 1),
        "study": RoomLook(palette.boards, paints[4], 1, curtain + 2),
        "bath": RoomLook(palette.stone, palette.tiles, 0),
        "laundry": RoomLook(palette.stone, paints[5], 0),
        "hall": RoomLook(palette.boards, paints[5], 1),
    }
