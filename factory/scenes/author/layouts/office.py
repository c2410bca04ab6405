"""Layout of the family `office`: open plan rooms, private offices, meeting rooms and service rooms along halls.

The kinds, sizes, order and doors of the rooms, the halls and the style differ by seed. Lengths in metres. Places larger
props first. Does not build walls.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from factory.scenes.author.circulation import RoomSpec, Scheme, l_hall, no_hall, ring_hall, spine_hall, t_hall
from factory.scenes.author.dwelling import BuildingLook, BuiltRoom, RoomLook, build_rooms
from factory.scenes.author.furnisher import (
    Furnisher,
    chairs_around,
    complete,
    enter,
    kitchen_row,
    round_table,
    seat_group,
    workplace,
)
from factory.scenes.author.materials import SurfaceMaterial
from factory.scenes.author.partition import Division, Doors, divide_floor, turned
from factory.scenes.author.placement import FACING, FloorPlan, PropPlacement, Rectangle
from factory.scenes.author.style import OFFICE, Palette, draw_palette

_EVERYWHERE = {"SM_Plant_A": 4, "SM_TrashCan_A": 5, "SM_FireExtinguisher_02": 4, "SM_Whiteboard_A": 4}
_SEATED = {"SM_Sofa_A": 4}
_AT_WORK = {"SM_TableDesk_A": 4}
"""Pieces that every office has, with their minimum numbers."""
_ON_BOARDS = ("SM_BookRow", "SM_BookPile", "SM_Papers", "SM_Globe", "SM_Bouquet", "SM_Portrait")
_ON_TABLES = ("SM_Papers", "SM_Laptop", "SM_Bouquet", "SM_Tray")
_ON_BISTRO = ("SM_Crockery", "SM_FruitBowl", "SM_Bouquet")
_BISTRO_M, _MEETING_M = 0.74, 0.75
"""Heights of a round table and of a meeting table, metres."""
_UNITS = ("SM_SinkUnit", "SM_Dishwasher", "SM_KitchenUnit", "SM_KitchenUnit")
_OPPOSITE = {"N": "S", "S": "N", "E": "W", "W": "E"}
_WALLS = ("SM_PictureFrame", "SM_PictureFrame", "SM_PinBoard", "SM_ClockWall", "SM_WallMap")


def furnish_office(plan: FloorPlan, rooms: Sequence[BuiltRoom], palette: Palette, clutter: float) -> None:
    """Furnishes every room by its kind; `clutter` is the probability of each small thing."""
    kinds: dict[str, Callable[[Furnisher], None]] = {
        "open": _open_plan,
        "private": _private,
        "meeting": _meeting,
        "lounge": _lounge,
        "kitchen": _kitchen,
        "reception": _reception,
        "library": _library,
        "print": _print,
        "store": _store,
        "wash": _wash,
        "hall": _hall,
    }
    furnishers = [Furnisher(plan, room, palette, clutter) for room in rooms]
    enter(furnishers, ("reception", "hall", "lounge", "open"), plan.pick(39))
    for each in furnishers:
        kinds[each.room.kind](each)
    complete(plan, furnishers, _AT_WORK, ("open", "private"))
    complete(plan, furnishers, _SEATED, ("lounge", "reception", "private", "open", "library", "hall"))
    complete(plan, furnishers, _EVERYWHERE, ("open", "private", "meeting", "lounge", "kitchen", "reception", "hall"))
    for each in furnishers:
        each.hang_all()


def _open_plan(furnisher: Furnisher) -> None:
    """Places desks in islands, in rows or along the walls, boards, cabinets, plants, bins, sometimes a seat group."""
    plan, rng, look = furnisher.plan, furnisher.rng, furnisher.palette.wood
    chair = plan.pick(5)
    furnisher.wall_piece("SM_Whiteboard_A", None, clearance=0.3)
    if rng.random() < 0.45:
        seat_group(furnisher, rug=plan.pick(3))
    (_islands, _islands, _rows, _wall_desks)[plan.pick(4)](furnisher, chair)
    if rng.random() < 0.5:
        furnisher.wall_piece("SM_ShelfBook_B", look, clearance=0.3)
    for _ in range(1 + plan.pick(3)):
        furnisher.dress(furnisher.wall_piece("SM_Sideboard", look, clearance=0.4), _ON_BOARDS, 2)
    furnisher.corner("SM_Plant_A")
    furnisher.corner("SM_Plant_A")
    furnisher.small(
        ("SM_TrashCan_A", "SM_TrashCan_A", "SM_Printer", "SM_CoatStand", "SM_ComputerCase", "SM_Plant_A"), 0.45
    )
    furnisher.small(("SM_FireExtinguisher_02", "SM_WaterDispenser", "SM_Backpack", "SM_LampFloor"), 0.45)
    for name in _WALLS:
        furnisher.hang(name)


def _islands(furnisher: Furnisher, chair: int) -> None:
    """Places islands of two or three pairs of desks back to back, with aisles of at least 1.5 m."""
    plan, area = furnisher.plan, furnisher.area
    desk = furnisher.model("SM_TableDesk_A", furnisher.palette.wood)
    width, depth = (float(high - low) + 0.02 for low, high in zip(desk.low[:2], desk.high[:2], strict=True))
    is_along_x = (area.width >= area.depth) != (furnisher.rng.random() < 0.25)
    length, across = (area.width, area.depth) if is_along_x else (area.depth, area.width)
    count = 2 + plan.pick(2)
    islands = max(1, int((length - 1.6 + 1.5) // (count * width + 1.5)))
    rows = max(1, int((across - 1.2) // (2 * depth + 2.3)))
    for island in range(islands):
        for row in range(rows):
            middle, line = (island + 0.5) * length / islands, (row + 0.5) * across / rows
            for place in range(count):
                along = middle + (place - (count - 1) / 2) * width
                for side, yaw in ((-1, 0.0), (1, math.pi)):
                    u, v = along, line + side * depth / 2
                    x, y = (area.x0 + u, area.y0 + v) if is_along_x else (area.x0 + v, area.y0 + u)
                    turn = yaw if is_along_x else -yaw - math.pi / 2
                    workplace(furnisher, plan.place(desk, x, y, turn, area, 0.005), chair, is_second=True)


def _rows(furnisher: Furnisher, chair: int) -> None:
    """Places desks in rows that face one wall, in pairs with aisles of 1.2 m."""
    plan, look, front = furnisher.plan, furnisher.palette.wood, furnisher.sides()[0]
    desk = furnisher.model("SM_TableDesk_A", look)
    width = float(desk.high[0] - desk.low[0]) + 0.02
    length = furnisher.length(front)
    depth = furnisher.area.depth if front in "NS" else furnisher.area.width
    pairs = max(1, int((length - 1.2 + 1.2) // (2 * width + 1.2)))
    for row in range(max(1, int((depth - 1.6) // 1.75))):
        for pair in range(pairs):
            for side in (-0.5, 0.5):
                along = (pair + 0.5) * length / pairs + side * width
                x, y = furnisher.at_wall(front, along, 1.5 + 1.75 * row)
                workplace(furnisher, plan.place(desk, x, y, FACING[front], furnisher.area, 0.005), chair)


def _wall_desks(furnisher: Furnisher, chair: int) -> None:
    """Places desks along the walls, and a table with chairs in the middle."""
    desk = furnisher.model("SM_TableDesk_A", furnisher.palette.wood)
    for _ in range(int((furnisher.area.width + furnisher.area.depth) / 2.2)):
        workplace(
            furnisher,
            furnisher.wall_piece("SM_TableDesk_A", furnisher.palette.wood, sides=None, clearance=0.35, gap=0.06),
            chair,
            is_second=True,
        )
    if furnisher.rng.random() < 0.5:
        table = furnisher.plan.place(
            furnisher.model("SM_TableMeeting_B"), *furnisher.area.centre, 0.0, furnisher.area, 1.0
        )
        if table is not None:
            chairs_around(furnisher, table, kind="SM_ChairVisitor_C", look=chair, share=0.7)
            _on_table(furnisher, table)
    else:
        x, y = furnisher.area.centre
        workplace(furnisher, furnisher.plan.place(desk, x, y, FACING[furnisher.sides()[0]], furnisher.area, 0.9), chair)


def _on_table(furnisher: Furnisher, table: PropPlacement) -> None:
    """Adds things to both halves of a meeting table, beside the sockets in its middle."""
    for along in (-0.5, 0.45):
        if furnisher.is_wanted() and furnisher.rng.random() < 0.7:
            furnisher.on_top(
                _ON_TABLES[furnisher.plan.pick(len(_ON_TABLES))], None, below=table, height=_MEETING_M, along=along
            )


def _private(furnisher: Furnisher) -> None:
    """Places a desk at a wall or in front of it, a seat for visitors, a cabinet, shelves and pictures."""
    plan, rng, look = furnisher.plan, furnisher.rng, furnisher.palette.wood
    chair = plan.pick(5)
    front = furnisher.sides()[plan.pick(2)]
    desk = None
    if rng.random() < 0.5:
        x, y = furnisher.at_wall(front, float(rng.uniform(0.4, 0.6)) * furnisher.length(front), 1.35)
        desk = plan.place(furnisher.model("SM_TableDesk_A", look), x, y, FACING[_OPPOSITE[front]], furnisher.area, 0.5)
        if desk is not None:
            furnisher.before("SM_ChairVisitor_C", chair, of=desk, reach=-0.85, along=0.35, turn=math.pi)
    workplace(
        furnisher, desk or furnisher.wall_piece("SM_TableDesk_A", look, clearance=0.5, gap=0.06), chair, is_second=True
    )
    if rng.random() < 0.6 or not furnisher.wall_piece("SM_ChairLounge_G", furnisher.palette.cover, clearance=0.3):
        furnisher.wall_piece("SM_Sofa_A", furnisher.palette.cover, clearance=0.3, gap=0.05)
    if rng.random() < 0.6:
        furnisher.wall_piece("SM_ShelfBook_B", look, clearance=0.3)
    furnisher.dress(furnisher.wall_piece("SM_Sideboard", look, clearance=0.35), _ON_BOARDS, 3)
    furnisher.corner("SM_Plant_A")
    furnisher.small(("SM_TrashCan_A", "SM_CoatStand", "SM_LampFloor"), 0.4)
    if rng.random() < 0.4:
        furnisher.carpet(furnisher.area.centre, 2.0, 1.4, plan.pick(3))
    furnisher.hang("SM_PictureFrame", 2)
    furnisher.hang("SM_WallLedge")


def _meeting(furnisher: Furnisher) -> None:
    """Places one or two tables in a line, or a round table, with chairs, and a board, a screen and a cabinet."""
    plan, rng = furnisher.plan, furnisher.rng
    kind, look = ("SM_ChairVisitor_C", "SM_ChairOffice_A", "SM_ChairWaiting_E")[plan.pick(3)], plan.pick(5)
    furnisher.wall_piece("SM_Whiteboard_A", None, clearance=0.3)
    yaw = 0.0 if furnisher.area.width >= furnisher.area.depth else math.pi / 2
    table = furnisher.model("SM_TableMeeting_B", furnisher.palette.wood)
    x, y = furnisher.area.centre
    if max(furnisher.area.width, furnisher.area.depth) < 4.9 and rng.random() < 0.35:
        round_table(furnisher, (x, y), kind, look)
    else:
        is_double = max(furnisher.area.width, furnisher.area.depth) > 6.4
        places = [(x + s * math.cos(yaw), y + s * math.sin(yaw)) for s in ((-0.98, 0.98) if is_double else (0.0,))]
        tables = [plan.place(table, *place, yaw, furnisher.area, 0.01 if is_double else 0.5) for place in places]
        for table_placed in filter(None, tables):
            chairs_around(furnisher, table_placed, kind=kind, look=look, share=0.85)
            _on_table(furnisher, table_placed)
    furnisher.hang("SM_Television")
    furnisher.dress(furnisher.wall_piece("SM_Sideboard", furnisher.palette.wood, clearance=0.35), _ON_BOARDS, 2)
    furnisher.corner("SM_Plant_A")
    furnisher.small(("SM_TrashCan_A", "SM_Plant_A"), 0.4)
    furnisher.hang("SM_PictureFrame")
    furnisher.hang("SM_ClockWall")


def _lounge(furnisher: Furnisher) -> None:
    """Places groups of seats, a bistro table, shelves, plants and pictures."""
    plan, rng = furnisher.plan, furnisher.rng
    seat_group(furnisher, rug=0)
    if furnisher.area.width * furnisher.area.depth > 26:
        seat_group(furnisher, rug=1)
    x, y = furnisher.area.centre
    shift = float(rng.uniform(-0.6, 0.6))
    table = round_table(furnisher, (x + shift, y - shift), "SM_ChairWood_D", furnisher.palette.wood)
    if table is not None:
        furnisher.dress(table, _ON_BISTRO, 1, _BISTRO_M)
    furnisher.wall_piece("SM_ShelfBook_B", furnisher.palette.wood, clearance=0.3)
    if rng.random() < 0.4:
        furnisher.wall_piece("SM_VendingMachine", clearance=0.3)
    furnisher.corner("SM_Plant_A")
    furnisher.corner("SM_Plant_A")
    furnisher.small(("SM_LampFloor", "SM_Ottoman", "SM_TrashCan_A", "SM_FireExtinguisher_02", "SM_Vase"), 0.4)
    furnisher.hang(("SM_Tapestry", "SM_Television")[plan.pick(2)])
    furnisher.hang("SM_PictureFrame", 3)


def _kitchen(furnisher: Furnisher) -> None:
    """Places a row of units with a sink and a dishwasher, a refrigerator, and round tables or a counter with stools."""
    plan, rng, look = furnisher.plan, furnisher.rng, furnisher.palette.wood
    sides = furnisher.sides()
    main = kitchen_row(furnisher, sides, look=look, names=_UNITS, tops=("SM_Microwave", "SM_CoffeeMachine"))
    furnisher.wall_piece("SM_Refrigerator", None, "".join(side for side in sides if side != main), 0.05)
    chair = ("SM_ChairWood_D", "SM_ChairWaiting_E")[plan.pick(2)]
    is_along_x = furnisher.area.width >= furnisher.area.depth
    if rng.random() < 0.3:
        island = plan.place(
            furnisher.model("SM_CounterIsland", look), *furnisher.area.centre, FACING[main or "N"], furnisher.area, 0.9
        )
        if island is not None:
            for shift in (-0.4, 0.4):
                furnisher.before("SM_Stool_F", 1, of=island, reach=0.62, along=shift)
    else:
        for share in (0.3, 0.7) if max(furnisher.area.width, furnisher.area.depth) > 5.0 else (0.5,):
            x = furnisher.area.x0 + (share if is_along_x else float(rng.uniform(0.4, 0.6))) * furnisher.area.width
            y = furnisher.area.y0 + (float(rng.uniform(0.4, 0.6)) if is_along_x else share) * furnisher.area.depth
            table = round_table(furnisher, (x, y), chair, plan.pick(6))
            furnisher.dress(table, _ON_BISTRO, 1, _BISTRO_M)
    furnisher.small(
        ("SM_TrashCan_A", "SM_TrashCan_A", "SM_WaterDispenser", "SM_FireExtinguisher_02", "SM_Plant_A"), 0.35
    )
    furnisher.hang("SM_WallLedge")
    furnisher.hang("SM_PictureFrame")
    furnisher.hang("SM_ClockWall")


def _reception(furnisher: Furnisher) -> None:
    """Places a counter near a wall with a stool and cabinets behind it, seats for visitors and plants."""
    plan, side = furnisher.plan, furnisher.sides()[0]
    counter = furnisher.model("SM_Reception")
    for clearance in (0.6, 0.3):
        x, y = furnisher.at_wall(side, float(furnisher.rng.uniform(0.4, 0.6)) * furnisher.length(side), 1.75)
        placed = plan.place(counter, x, y, FACING[side], furnisher.area, clearance)
        if placed is not None:
            furnisher.before(
                "SM_ChairOffice_A", furnisher.palette.cover, of=placed, reach=-0.75, along=0.2, turn=math.pi
            )
            furnisher.wall_piece("SM_Sideboard", furnisher.palette.wood, side, 0.02)
            break
    seat_group(furnisher, rug=0)
    furnisher.corner("SM_Plant_A")
    furnisher.corner("SM_Plant_A")
    furnisher.small(
        ("SM_WaterDispenser", "SM_TrashCan_A", "SM_CoatStand", "SM_FireExtinguisher_02", "SM_LampFloor"), 0.45
    )
    furnisher.wall_piece("SM_ChairLounge_G", furnisher.palette.cover, clearance=0.4)
    furnisher.hang("SM_Television")
    furnisher.hang("SM_PictureFrame", 3)


def _library(furnisher: Furnisher) -> None:
    """Places book cases, arm chairs with a lamp and a desk for quiet work."""
    for number in range(3 + furnisher.plan.pick(3)):
        furnisher.wall_piece("SM_ShelfBook_B", furnisher.palette.wood + 4 * number, clearance=0.12)
    seat_group(furnisher, rug=1)
    workplace(
        furnisher,
        furnisher.wall_piece("SM_TableDesk_A", furnisher.palette.wood, clearance=0.45, gap=0.06),
        furnisher.plan.pick(5),
    )
    furnisher.small(("SM_LampFloor", "SM_Ottoman", "SM_TrashCan_A", "SM_Plant_A"), 0.35)
    furnisher.hang("SM_PictureFrame", 2)


def _print(furnisher: Furnisher) -> None:
    """Places copiers, cabinets, cartons of paper and a bin."""
    furnisher.wall_piece("SM_Copier", clearance=0.3)
    furnisher.wall_piece("SM_Printer", clearance=0.3)
    furnisher.dress(
        furnisher.wall_piece("SM_Sideboard", furnisher.palette.wood, clearance=0.3),
        ("SM_Papers", "SM_Tray", "SM_BookRow"),
    )
    furnisher.wall_piece("SM_ShelfSteel_A", clearance=0.2)
    furnisher.small(("SM_CartonSingle", "SM_TrashCan_A", "SM_CartonSingle", "SM_TrashCan_A"), 0.3)
    furnisher.hang("SM_PinBoard")


def _store(furnisher: Furnisher) -> None:
    """Places steel shelves, cartons, a ladder, computers and a fan."""
    for number in range(2 + furnisher.plan.pick(2)):
        furnisher.wall_piece("SM_ShelfSteel_A", number, clearance=0.12)
    furnisher.wall_piece("SM_Locker", clearance=0.2)
    furnisher.small(("SM_CartonSingle", "SM_CartonSingle", "SM_StepLadder", "SM_ComputerCase", "SM_Fan"), 0.3)


def _wash(furnisher: Furnisher) -> None:
    """Places toilets, basins with a mirror and a bin."""
    for _ in range(2):
        furnisher.wall_piece("SM_Toilet", clearance=0.3, gap=0.0)
        furnisher.wall_piece("SM_WashBasin", furnisher.palette.cover, clearance=0.25, gap=0.0)
    furnisher.small(("SM_TrashCan_A", "SM_TrashCan_A"), 0.3)


def _hall(furnisher: Furnisher) -> None:
    """Places plants, bins, extinguishers, benches and lockers along the walls, and mounts pictures and boards."""
    plan, rng = furnisher.plan, furnisher.rng
    is_wide = min(furnisher.area.width, furnisher.area.depth) > 2.1
    if is_wide and rng.random() < 0.6:
        furnisher.wall_piece("SM_Bench", furnisher.palette.wood, clearance=0.5)
    if is_wide and rng.random() < 0.4:
        furnisher.wall_piece("SM_Locker", furnisher.palette.cover, clearance=0.5)
    if is_wide and rng.random() < 0.4:
        furnisher.wall_piece("SM_Sideboard", furnisher.palette.wood, clearance=0.5)
    furnisher.corner("SM_Plant_A")
    furnisher.small(("SM_FireExtinguisher_02", "SM_TrashCan_A", "SM_Plant_A", "SM_WaterDispenser"), 0.55)
    if plan.pick(2):
        length = 0.75 * max(furnisher.area.width, furnisher.area.depth)
        furnisher.carpet(
            furnisher.area.centre, *((length, 0.9) if furnisher.area.width > furnisher.area.depth else (0.9, length)), 2
        )
    furnisher.hang("SM_PinBoard")
    furnisher.hang("SM_ClockWall")
    furnisher.hang("SM_PictureFrame", 3)


_CEILINGS = ("tiles", "tiles", "panels", "ducts", "plain", "boards")
_OPEN = {
    frozenset(("open", "hall")): (1.5, 2.4),
    frozenset(("lounge", "hall")): (1.6, 2.8),
    frozenset(("reception", "hall")): (1.8, 2.6),
    frozenset(("open", "lounge")): (1.8, 3.2),
    frozenset(("open", "reception")): (1.6, 2.6),
    frozenset(("kitchen", "lounge")): (1.5, 2.4),
    frozenset(("open",)): (1.6, 3.0),
}


def lay_out_office(plan: FloorPlan) -> None:
    """Builds the rooms of one storey, then furnishes them.

    Raises:
        WorldError: no division of the floor into the chosen rooms was found; another seed may have one.
    """
    palette, rng = draw_palette(plan.rng, OFFICE), plan.rng
    ceiling, height = _CEILINGS[plan.pick(len(_CEILINGS))], float(rng.choice((2.7, 2.8, 3.0, 3.3)))
    building = BuildingLook(
        _looks(palette, plan), palette.trim, leaf=palette.leaf, ceiling=ceiling, views=palette.views, height=height
    )
    rooms = build_rooms(plan, _divide(plan), building)
    furnish_office(plan, rooms, palette, float(rng.uniform(0.55, 1.0)))


def _divide(plan: FloorPlan) -> Division:
    """Chooses the rooms, the halls and the outline at random."""
    rng = plan.rng
    specs, hall = _program(plan), float(rng.uniform(1.8, 2.5))
    area, ratio = sum(spec.area_m2 for spec in specs), float(rng.uniform(1.0, 1.6))
    width = (area * ratio) ** 0.5
    scheme = _scheme(plan, len(specs), area, hall)
    outline = Rectangle(0.0, 0.0, width, area / width)
    doors = Doors(float(rng.uniform(1.0, 1.25)), _OPEN, float(rng.uniform(0.2, 0.9)))
    return turned(rng, divide_floor(rng, outline, specs=specs, doors=doors, scheme=scheme))


def _scheme(plan: FloorPlan, rooms: int, area_m2: float, hall_m: float) -> Scheme:
    """Chooses at random an arrangement of the halls that suits the size of the building."""
    schemes = [spine_hall(hall_m), spine_hall(hall_m), t_hall(hall_m), l_hall(hall_m), l_hall(hall_m)]
    if rooms <= 8:
        schemes += [no_hall, no_hall]
    if area_m2 > 230:
        schemes += [ring_hall(hall_m), ring_hall(hall_m)]
    return schemes[plan.pick(len(schemes))]


def _program(plan: FloorPlan) -> list[RoomSpec]:
    """Chooses at random the rooms of an office with few, some or many rooms for one person."""
    rng = plan.rng
    open_rooms, private = ((3, 1), (2, 2), (2, 3), (1, 4), (1, 3))[plan.pick(5)]

    def room(kind: str, low: float, high: float, least: float, is_hub: bool = False) -> RoomSpec:
        return RoomSpec(kind, float(rng.uniform(low, high)), least, is_hub)

    specs = [room("open", 42, 74, 5.4, True) for _ in range(open_rooms)]
    specs += [room("private", 12.5, 18, 3.1) for _ in range(private)]
    specs += [room("meeting", 17, 30, 3.7) for _ in range(1 + plan.pick(2))]
    specs += [room("kitchen", 17, 25, 3.3), room("wash", 9.5, 13, 2.6)]
    for kind, low, high, least, is_hub, share in (
        ("lounge", 22, 34, 4.0, True, 0.55),
        ("reception", 24, 34, 4.2, True, 0.45),
        ("print", 9, 13, 2.6, False, 0.5),
        ("store", 9, 14, 2.6, False, 0.4),
        ("library", 14, 22, 3.3, False, 0.35),
    ):
        if rng.random() < share:
            specs.append(room(kind, low, high, least, is_hub))
    return specs


def _looks(palette: Palette, plan: FloorPlan) -> dict[str, RoomLook]:
    paints, pile = palette.paints, palette.pile
    window, pitch = (("SM_WindowHome", 2.5), ("SM_WindowBand", 3.1), ("SM_WindowBand", 2.7))[plan.pick(3)]
    curtain = palette.curtain if window == "SM_WindowHome" and plan.pick(3) == 0 else None
    dry = (palette.stone, palette.boards, pile)[plan.pick(3)]

    def look(floor: SurfaceMaterial, number: int, windows: int, drape: int | None = None) -> RoomLook:
        return RoomLook(floor, paints[number], windows=windows, curtain=drape, window=window, window_pitch_m=pitch)

    return {
        "open": look(pile, 0, 5),
        "meeting": look(pile, 1, 2, curtain),
        "private": look(pile, 2, 1, curtain),
        "lounge": look(palette.boards, 3, 3, curtain),
        "kitchen": look(palette.stone, 4, 2),
        "reception": look(dry, 3, 3),
        "library": look(palette.boards, 1, 2, curtain),
        "print": look(palette.stone, 5, 1),
        "store": look(palette.stone, 5, 0),
        "wash": RoomLook(palette.stone, palette.tiles, 0),
        "hall": RoomLook(dry, paints[5], windows=4, curtain=None, window=window, window_pitch_m=max(pitch, 3.0)),
    }
