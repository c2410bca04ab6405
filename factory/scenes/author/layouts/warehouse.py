"""Layouts of the families `full_warehouse` and `warehouse_multiple_shelves`: a hall of one or more parts with rows of
racks and shelves, gates, a staging floor, and, in most of them, an office, a break room and a washroom.

The parts, sizes, rows, zones and style differ by seed. `racks` places the rows; `warehouse_floor` furnishes the rest.
"""

from __future__ import annotations

from typing import NamedTuple

from numpy.random import Generator

from factory.scenes.author.circulation import HALL, Arrangement, Block, RoomSpec, Specs
from factory.scenes.author.dwelling import BuildingLook, RoomLook, build_rooms
from factory.scenes.author.layouts.warehouse_floor import HallKind, furnish_warehouse
from factory.scenes.author.materials import painted, tinted
from factory.scenes.author.partition import Division, Doors, divide_floor, turned
from factory.scenes.author.placement import FloorPlan, Rectangle
from factory.scenes.author.room import Trim
from factory.scenes.author.style import HALL as HALL_FINISHES
from factory.scenes.author.style import Palette, draw_palette

_KICKS = ("#7d868d", "#5f7d8c", "#8a7d5c", "#7a8a6a", "#8c6a5c", "#55606a")
_ROW_DEPTH_M = (3.2, 4.2)
"""Range of the depth of the rooms beside the hall, metres."""
_LEAST_PART_M = 2.6
"""Least length of the part of the hall beside the row of rooms, metres. If less remains, the row is as long as the
hall."""


class _Size(NamedTuple):
    """Ranges of the floor area of the main part of the hall, square metres, and of the height of the walls, metres."""

    hall_m2: tuple[float, float]
    height_m: tuple[float, float]


_FULL = HallKind(("rack",), (2.6, 3.3), 0.4, 20)
_MULTIPLE = HallKind(("rack", "shelf"), (1.9, 2.5), 0.1, 14)


def lay_out_full_warehouse(plan: FloorPlan) -> None:
    """Builds a hall for pallets: rows of racks with wide aisles, goods on the floor, shelves along the walls.

    Raises:
        WorldError: no division of the floor into the chosen rooms was found; another seed may have one.
    """
    _lay_out(plan, _FULL, _Size((360, 620), (5.6, 6.6)))


def lay_out_multiple_shelves(plan: FloorPlan) -> None:
    """Builds a smaller hall in which rows of racks and of shelves alternate.

    Raises:
        WorldError: no division of the floor into the chosen rooms was found; another seed may have one.
    """
    _lay_out(plan, _MULTIPLE, _Size((230, 380), (5.3, 6.0)))


def _lay_out(plan: FloorPlan, kind: HallKind, size: _Size) -> None:
    palette, rng = draw_palette(plan.rng, HALL_FINISHES), plan.rng
    kick = _KICKS[plan.pick(len(_KICKS))]
    dado = tinted("Plaster", f"KickPlaster{kick[1:]}", kick, 1.0, 0.8)
    frame = (painted("Grey", 0.5), painted("Charcoal", 0.5), painted("Yellow", 0.5))[plan.pick(3)]
    trim = Trim(None, dado, float(rng.choice((0.8, 1.1, 1.4))), has_sockets=False, frame=frame)
    height = float(rng.uniform(*size.height_m))
    building = BuildingLook(_looks(palette), trim, palette.leaf, "girders", palette.views, height)
    rooms = build_rooms(plan, _divide(plan, float(rng.uniform(*size.hall_m2))), building)
    furnish_warehouse(plan, rooms, palette, kind)


def _looks(palette: Palette) -> dict[str, RoomLook]:
    paints = palette.paints

    def cabin(number: int, windows: int) -> RoomLook:
        return RoomLook(palette.pile, paints[number], windows, trim=palette.trim, ceiling="tiles", height=2.7)

    return {
        HALL: RoomLook(palette.stone, paints[0], 6, window="SM_WindowStrip", window_pitch_m=4.2),
        "office": cabin(1, 1),
        "break": cabin(2, 1),
        "wash": cabin(3, 0)._replace(floor=palette.stone, paint=palette.tiles),
        "tools": cabin(4, 0)._replace(floor=palette.stone),
    }


def _divide(plan: FloorPlan, hall_m2: float) -> Division:
    """Chooses the rooms, the outline of the hall and its parts at random."""
    rng = plan.rng
    ratio = float(rng.uniform(1.05, 1.9))
    outline = Rectangle(0.0, 0.0, (hall_m2 * ratio) ** 0.5, (hall_m2 / ratio) ** 0.5)
    specs = []
    for kind, low, high, least, share in (
        ("office", 12, 18, 3.0, 0.8),
        ("break", 13, 19, 3.0, 0.5),
        ("wash", 9, 12, 2.5, 0.45),
        ("tools", 10, 16, 2.7, 0.4),
    ):
        if rng.random() < share:
            specs.append(RoomSpec(kind, float(rng.uniform(low, high)), least))
    doors = Doors(float(rng.uniform(1.1, 1.35)), {}, 0.0)
    return turned(rng, divide_floor(rng, outline, specs, doors, _parts_of_a_hall))


def _parts_of_a_hall(rng: Generator, floor: Rectangle, specs: Specs) -> Arrangement:
    """Arranges the rooms in a row at the west wall, and the hall as a main part, a part beside the row and a wing."""
    depth = float(rng.uniform(*_ROW_DEPTH_M)) if specs else 0.0
    length = sum(max(spec.area_m2 / depth, spec.least_m) for spec in specs)
    if floor.depth - length < _LEAST_PART_M:
        length = floor.depth if specs else 0.0
    main = floor._replace(x0=floor.x0 + depth)
    halls = [main]
    row = Rectangle(floor.x0, floor.y0, main.x0, floor.y0 + length)
    if specs and row.y1 < floor.y1:
        halls.append(row._replace(y0=row.y1, y1=floor.y1))
    if rng.random() < 0.45:
        width, high = (float(rng.uniform(*span)) for span in ((0.35, 0.65), (0.30, 0.55)))
        left = main.x0 + float(rng.choice((0.0, 1.0))) * (1 - width) * main.width
        halls.append(Rectangle(left, floor.y1, left + width * main.width, floor.y1 + high * floor.depth))
    return Arrangement((Block(row, specs, 1.0),) if specs else (), tuple(halls))
