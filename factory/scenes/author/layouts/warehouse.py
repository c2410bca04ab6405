"""Layouts of the families `full_warehouse` and `warehouse_multiple_shelves`: a hall of one or more parts with rows of
racks and shelves, gates, a staging floor, and, in most of them, an office, a break room and a washroom.

The parts, sizes, rows, zones and style differ by seed. `racks` places the rows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from numpy.random import Generator

from factory.scenes.author.circulation import HALL, Arrangement, Block, RoomSpec, Specs
from factory.scenes.author.dwelling import BuildingLook, BuiltRoom, RoomLook, build_rooms
from factory.scenes.author.furnisher import Furnisher, complete, enter, round_table, workplace
from factory.scenes.author.layouts.racks import RackPlan, fill_with_racks
from factory.scenes.author.materials import painted, tinted
from factory.scenes.author.partition import Division, Doors, divide_floor, turned
from factory.scenes.author.placement import FACING, FloorPlan, Rectangle
from factory.scenes.author.room import Trim, marking
from factory.scenes.author.style import HALL as HALL_FINISHES
from factory.scenes.author.style import Palette, draw_palette
from schemas.errors import WorldError

_EVERYWHERE = {
    "SM_RackPile_04": 4,
    "SM_BarelPlastic_A": 5,
    "SM_CratePlastic_A": 4,
    "SM_CrateWood_B": 3,
    "SM_ShelfSteel_A": 4,
}
"""Pieces that every warehouse has, with their minimum numbers."""
_GOODS = ("SM_BarelPlastic_A", "SM_CratePlastic_A", "SM_BarelPlastic_A", "SM_CrateWood_B")
_STAGED = (
    "SM_CardBoxPile",
    "SM_PalletPile",
    "SM_CrateWood_B",
    "SM_CardBoxPile",
    "SM_BarelPlastic_A",
    "SM_CratePlastic_A",
)
_TOOLS = ("SM_PalletTruck", "SM_Cone", "SM_StepLadder", "SM_Cone", "SM_PalletTruck", "SM_Fan", "SM_TrashCan_A")
_GATE_PITCH_M = 4.4
_GATE_CLEAR_M = 1.8
_OPPOSITE = {"N": "S", "S": "N", "E": "W", "W": "E"}
_LEAST_RACK_M = 7.0
"""A part of the hall contains racks only if its shorter side has at least this length, metres."""


class HallKind(NamedTuple):
    """Kind of a warehouse. The properties of its rows are drawn at random within these limits."""

    kinds: tuple[str, ...]
    aisle_m: tuple[float, float]
    double: float
    """Largest probability of double rows."""
    goods: int
    """Number of goods along the walls in a hall of 500 m2."""


def furnish_warehouse(plan: FloorPlan, rooms: Sequence[BuiltRoom], palette: Palette, kind: HallKind) -> None:
    """Furnishes the parts of the hall and the side rooms.

    Raises:
        WorldError: the hall has no room for the minimum number of racks.
    """
    furnishers = [Furnisher(plan, room, palette) for room in rooms]
    parts = sorted((each for each in furnishers if each.room.kind == HALL), key=lambda each: -_floor_of(each.area))
    gates = _gates(parts[0])
    enter(parts, (HALL,), 2 + 3 * plan.pick(13))
    for number, part in enumerate(parts):
        _hall(part, kind, gates if number == 0 else None)
    side_rooms: dict[str, Callable[[Furnisher], None]] = {
        "office": _office, "break": _break_room, "wash": _wash, "tools": _tools,
    }  # fmt: skip
    for each in furnishers:
        if each.room.kind in side_rooms:
            side_rooms[each.room.kind](each)
    complete(plan, parts, _EVERYWHERE)
    racks = sum(placement.model.name.startswith("SM_RackPile_04") for placement in plan.placements)
    if racks < _EVERYWHERE["SM_RackPile_04"]:
        raise WorldError(f"room for only {racks} racks")
    for each in furnishers:
        each.hang_all()


def _floor_of(area: Rectangle) -> float:
    return area.width * area.depth


def _gates(furnisher: Furnisher) -> str | None:
    """Adds loading gates to one outer wall, and keeps the floor before them clear; returns the side."""
    sides = [
        side
        for side in furnisher.sides()
        if any(high - low > 4.5 for low, high in furnisher.room.outside.get(side, ()))
    ]
    gate = furnisher.model("SM_RollerGate", 0)
    for side in sides:
        gates = 0
        for low, high in furnisher.room.outside[side]:
            count = min(1 + furnisher.plan.pick(4), int((high - low) // _GATE_PITCH_M))
            for number in range(count):
                along = low + (number + 0.5) * (high - low) / count
                x = {"W": furnisher.area.x0, "E": furnisher.area.x1}.get(side, along)
                y = {"S": furnisher.area.y0, "N": furnisher.area.y1}.get(side, along)
                if furnisher.plan.hang_at(gate, x, y, FACING[side]):
                    reach = (1.7, _GATE_CLEAR_M) if side in "NS" else (_GATE_CLEAR_M, 1.7)
                    furnisher.plan.keep_clear(Rectangle(x - reach[0], y - reach[1], x + reach[0], y + reach[1]))
                    gates += 1
        if gates:
            return side
    return None


def _hall(furnisher: Furnisher, kind: HallKind, gates: str | None) -> None:
    """Places racks in a part of the hall, goods on a staging floor before its gates, and shelves along its walls."""
    area, rng = furnisher.area, furnisher.rng
    if min(area.width, area.depth) < _LEAST_RACK_M:
        _stage(furnisher, area.grown(-0.6), 0.12)
    else:
        margin, ends = float(rng.uniform(2.2, 2.8)), float(rng.uniform(2.2, 3.2))
        is_along_x = bool(rng.random() < (0.7 if area.width > area.depth else 0.3))
        inner = area.grown(-margin)
        inner = inner._replace(x0=area.x0 + ends, x1=area.x1 - ends) if is_along_x else inner._replace(
            y0=area.y0 + ends, y1=area.y1 - ends)  # fmt: skip
        inner, staging = _split(inner, gates, float(rng.uniform(0.0, 0.24)))
        fill_with_racks(furnisher, inner, _rack_plan(furnisher, kind, is_along_x, inner))
        if staging is not None:
            _stage(furnisher, staging, float(rng.uniform(0.06, 0.11)))
    _along_walls(furnisher, kind)


def _split(area: Rectangle, side: str | None, share: float) -> tuple[Rectangle, Rectangle | None]:
    """Returns the floor for racks and the floor before the gates, which is `None` if it is small or `side` is `None`.

    Args:
        area: floor to split.
        side: side of the gates, if there are any.
        share: share of the depth for the floor before the gates.
    """
    if side is None or share < 0.08:
        return area, None
    x, y = area.width * share, area.depth * share
    return {
        "W": (area._replace(x0=area.x0 + x), area._replace(x1=area.x0 + x - 1.2)),
        "E": (area._replace(x1=area.x1 - x), area._replace(x0=area.x1 - x + 1.2)),
        "S": (area._replace(y0=area.y0 + y), area._replace(y1=area.y0 + y - 1.2)),
        "N": (area._replace(y1=area.y1 - y), area._replace(y0=area.y1 - y + 1.2)),
    }[side]


def _rack_plan(furnisher: Furnisher, kind: HallKind, is_along_x: bool, area: Rectangle) -> RackPlan:
    rng, plan = furnisher.rng, furnisher.plan
    length = area.width if is_along_x else area.depth
    crosses = (0, 1, 1, 1, 2)[plan.pick(5)] if length > 15.0 else (0, 1)[plan.pick(2)] if length > 9.5 else 0
    cross = tuple((number + 1) / (crosses + 1) + float(rng.uniform(-0.1, 0.1)) for number in range(crosses))
    first = plan.pick(len(kind.kinds))
    return RackPlan(
        kinds=(*kind.kinds[first:], *kind.kinds[:first]),
        is_along_x=is_along_x,
        aisle_m=float(rng.uniform(*kind.aisle_m)),
        double=float(rng.uniform(0.0, kind.double)),
        cross=cross,
        ragged=float(rng.uniform(0.0, 0.4)),
        filled=float(rng.uniform(0.88, 1.0)),
        frame=plan.pick(12),
    )


def _stage(furnisher: Furnisher, area: Rectangle, density: float) -> None:
    """Places pallets, piles, crates and barrels in a painted frame on the floor, with ways around them."""
    if area.width < 1.5 or area.depth < 1.5:
        return
    plan, rng = furnisher.plan, furnisher.rng
    paint = painted(("Yellow", "White", "Blue")[plan.pick(3)], 0.6)
    for line in (
        area._replace(y1=area.y0 + 0.08), area._replace(y0=area.y1 - 0.08),
        area._replace(x1=area.x0 + 0.08), area._replace(x0=area.x1 - 0.08),
    ):  # fmt: skip
        marking(plan, line, paint)
    if rng.random() < 0.6:
        _place(furnisher, area, "SM_ForkLift", 1.0)
    for _ in range(max(3, int(density * _floor_of(area)))):
        _place(furnisher, area, _STAGED[plan.pick(len(_STAGED))], 0.85)


def _place(furnisher: Furnisher, area: Rectangle, name: str, clearance: float) -> None:
    """Places a piece somewhere in an area, parallel to the walls."""
    model = furnisher.model(name)
    for _ in range(6):
        x, y = (float(furnisher.rng.uniform(low, high)) for low, high in ((area.x0, area.x1), (area.y0, area.y1)))
        if (
            furnisher.plan.place(model, x, y, math.pi / 2 * furnisher.plan.pick(4), furnisher.area, clearance)
            is not None
        ):
            return


def _along_walls(furnisher: Furnisher, kind: HallKind) -> None:
    """Places shelves, packing benches, goods alone and in clusters, tools and notices along the walls."""
    plan, rng = furnisher.plan, furnisher.rng
    share = _floor_of(furnisher.area) / 500
    for number in range(1 + round(rng.uniform(3, 8) * share)):
        furnisher.wall_piece("SM_ShelfSteel_A", None, None, 0.05 if number % 2 else 0.5)
    for _ in range(round(rng.uniform(0.5, 3) * share)):
        furnisher.wall_piece("SM_Workbench", clearance=0.4)
    for number in range(2 + round(kind.goods * share)):
        plan.against_somewhere(furnisher.model(_GOODS[number % 4]), furnisher.area, furnisher.sides(), 0.35)
    for _ in range(round(rng.uniform(2, 7) * share)):
        _cluster(furnisher)
    furnisher.small([_TOOLS[k] for k in rng.permutation(len(_TOOLS))[: 2 + round(4 * share)]], 0.5)
    for name in ("SM_PalletPile", "SM_CardBoxPile", "SM_PalletPile"):
        plan.against_somewhere(furnisher.model(name), furnisher.area, furnisher.sides(), 0.5)
    furnisher.small(("SM_FireExtinguisher_02",), 0.35)
    furnisher.hang("SM_SafetyNotice", 2 + round(4 * share))


def _cluster(furnisher: Furnisher) -> None:
    """Places two to four equal goods close together near a wall."""
    plan, rng, side = furnisher.plan, furnisher.rng, furnisher.sides()[furnisher.plan.pick(4)]
    name, variant = _GOODS[plan.pick(4)], plan.pick(12)
    along = float(rng.uniform(1.5, max(furnisher.length(side) - 1.5, 1.6)))
    for _ in range(2 + plan.pick(3)):
        x, y = furnisher.at_wall(side, along + float(rng.uniform(-0.8, 0.8)), 0.9 + float(rng.uniform(-0.35, 0.35)))
        plan.place(furnisher.model(name, variant), x, y, float(rng.uniform(-0.4, 0.4)), furnisher.area, 0.02)


def _office(furnisher: Furnisher) -> None:
    """Places desks with screens, a cabinet and a board."""
    for _ in range(1 + furnisher.plan.pick(2)):
        desk = furnisher.wall_piece("SM_TableDesk_A", furnisher.palette.wood, clearance=0.4, gap=0.06)
        workplace(furnisher, desk, furnisher.palette.cover)
    furnisher.wall_piece("SM_Cabinet", furnisher.plan.pick(3), clearance=0.25)
    furnisher.wall_piece("SM_Whiteboard_A", clearance=0.25)
    furnisher.small(("SM_TrashCan_A", "SM_Plant_A", "SM_Printer"), 0.35)
    furnisher.hang("SM_ClockWall")
    furnisher.hang("SM_PinBoard")


def _break_room(furnisher: Furnisher) -> None:
    """Places a table with chairs, lockers, a machine and a bin."""
    round_table(furnisher, furnisher.area.centre, "SM_ChairWaiting_E", furnisher.palette.cover)
    furnisher.wall_piece("SM_Locker", furnisher.palette.cover, clearance=0.2)
    furnisher.wall_piece("SM_VendingMachine", clearance=0.2)
    furnisher.wall_piece("SM_Bench", furnisher.palette.wood, clearance=0.2)
    furnisher.small(("SM_TrashCan_A", "SM_WaterDispenser", "SM_Plant_A"), 0.3)
    furnisher.hang("SM_PinBoard")
    furnisher.hang("SM_PictureFrame")


def _wash(furnisher: Furnisher) -> None:
    """Places toilets, basins and a bin."""
    furnisher.wall_piece("SM_Toilet", clearance=0.3, gap=0.0)
    for _ in range(2):
        furnisher.wall_piece("SM_WashBasin", furnisher.palette.cover, clearance=0.25, gap=0.0)
    furnisher.small(("SM_TrashCan_A",), 0.3)


def _tools(furnisher: Furnisher) -> None:
    """Places shelves, a bench, a ladder and cartons."""
    for _ in range(2):
        furnisher.wall_piece("SM_ShelfSteel_A", clearance=0.12)
    furnisher.wall_piece("SM_Workbench", clearance=0.3)
    furnisher.small(("SM_StepLadder", "SM_CartonSingle", "SM_CratePlastic_A", "SM_CartonSingle"), 0.3)


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
    dado = tinted("Plaster", f"KickPlaster{kick[1:]}", colour=kick, tile_m=1.0, roughness=0.8)
    frame = (painted("Grey", 0.5), painted("Charcoal", 0.5), painted("Yellow", 0.5))[plan.pick(3)]
    trim = Trim(None, dado, float(rng.choice((0.8, 1.1, 1.4))), has_sockets=False, frame=frame)
    height = float(rng.uniform(*size.height_m))
    building = BuildingLook(
        _looks(palette), trim, leaf=palette.leaf, ceiling="girders", views=palette.views, height=height
    )
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
    return turned(rng, divide_floor(rng, outline, specs=specs, doors=doors, scheme=_parts_of_a_hall))


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
