"""Layout of the family `school`: class rooms, a library or computer room, a staff room and wash rooms along a hall.

The number, sizes and order of the rooms, the rows of desks and the style differ by seed.
"""

from __future__ import annotations

import math

from factory.scenes.author.circulation import RoomSpec, straight_hall
from factory.scenes.author.dwelling import BuildingLook, RoomLook, build_rooms
from factory.scenes.author.furnisher import Furnisher, complete
from factory.scenes.author.partition import Division, Doors, divide_floor
from factory.scenes.author.placement import FACING, FloorPlan, Rectangle
from factory.scenes.author.style import PUBLIC, Palette, draw_palette

_IN_HALL = {
    "SM_TrafficCone": 2, "SM_Bicycle": 1, "SM_VendingMachine": 1, "SM_Bench": 1, "SM_Locker": 2, "SM_WaterDispenser": 1,
    "SM_FireExtinguisher_02": 2,
}  # fmt: skip
_IN_ROOMS = {
    "SM_Sofa_A": 1, "SM_Piano": 1, "SM_Whiteboard_A": 2, "SM_Copier": 1, "SM_ComputerCase": 2, "SM_ShelfBook_B": 2,
    "SM_Plant_A": 2, "SM_TrashCan_A": 3, "SM_Backpack": 3, "SM_LampFloor": 2,
}  # fmt: skip
"""Pieces that every school has, with their minimum numbers."""
_ON_CABINETS = ("SM_BookRow", "SM_Globe", "SM_Papers", "SM_BookPile", "SM_Bouquet")
_OPPOSITE = {"N": "S", "S": "N", "E": "W", "W": "E"}


def lay_out_school(plan: FloorPlan) -> None:
    """Builds the rooms, then furnishes them.

    Raises:
        WorldError: no division of the floor into the chosen rooms was found; another seed may have one.
    """
    palette = draw_palette(plan.rng, PUBLIC)
    ceiling = ("panels", "panels", "plain", "boards")[plan.pick(4)]
    building = BuildingLook(
        _looks(palette),
        palette.trim,
        leaf=palette.leaf,
        ceiling=ceiling,
        views=palette.views,
        height=float(plan.rng.uniform(2.8, 3.3)),
    )
    rooms = build_rooms(plan, _divide(plan), building)
    kinds = {
        "class": _class, "library": _library, "computing": _computing, "staff": _staff, "wash": _wash, "hall": _hall,
    }  # fmt: skip
    furnishers = [Furnisher(plan, room, palette) for room in rooms]
    for each in furnishers:
        kinds[each.room.kind](each)
    complete(plan, furnishers, _IN_HALL, ("hall", "library"))
    complete(plan, furnishers, _IN_ROOMS, ("class", "library", "computing", "staff"))
    for each in furnishers:
        each.hang_all()


def _divide(plan: FloorPlan) -> Division:
    rng = plan.rng
    specs = [RoomSpec("class", float(rng.uniform(44, 58)), 5.6) for _ in range(2 + plan.pick(2))]
    specs.append(RoomSpec("library", float(rng.uniform(34, 48)), 4.5))
    specs.append(RoomSpec("staff", float(rng.uniform(24, 32)), 3.6))
    specs.append(RoomSpec("wash", float(rng.uniform(15, 20)), 2.6))
    if rng.random() < 0.6:
        specs.append(RoomSpec("computing", float(rng.uniform(36, 48)), 4.8))
    hall = float(rng.uniform(2.6, 3.6))
    area, ratio = sum(spec.area_m2 for spec in specs), float(rng.uniform(1.3, 1.9))
    width = math.sqrt(area * ratio)
    doors = Doors(float(rng.uniform(1.15, 1.4)), {frozenset(("library", "hall")): (1.6, 2.4)}, 0.0)
    return divide_floor(
        rng, Rectangle(0.0, 0.0, width, area / width + hall), specs=specs, doors=doors, scheme=straight_hall(hall)
    )


def _looks(palette: Palette) -> dict[str, RoomLook]:
    paints = palette.paints
    return {
        "class": RoomLook(palette.boards, paints[0], 3),
        "library": RoomLook(palette.pile, paints[1], 2),
        "computing": RoomLook(palette.pile, paints[2], 2, palette.curtain),
        "staff": RoomLook(palette.boards, paints[3], 2, palette.curtain + 1),
        "wash": RoomLook(palette.stone, palette.tiles, 0),
        "hall": RoomLook(palette.stone, paints[4], 1),
    }


def _class(furnisher: Furnisher) -> None:
    """Places a whiteboard and a teacher's desk at one wall, rows of pupils' desks that face it, shelves and bags."""
    plan, rng = furnisher.plan, furnisher.rng
    board = furnisher.wall_piece("SM_Whiteboard_A", None, None, 0.2)
    front = furnisher.sides()[0]
    if board is not None:
        front = next(side for side, yaw in FACING.items() if math.cos(yaw - board.yaw) > 0.5)
    depth = furnisher.area.depth if front in "NS" else furnisher.area.width
    along = float(rng.uniform(0.15, 0.85))
    teacher = furnisher.model("SM_TableTeacher_G", furnisher.palette.wood)
    x, y = furnisher.at_wall(front, 0.8 + along * (furnisher.length(front) - 1.6), 1.55)
    desk = plan.place(teacher, x, y, FACING[_OPPOSITE[front]], furnisher.area, 0.3)
    if desk is not None:
        furnisher.before("SM_ChairOffice_A", None, desk, -0.6)
        furnisher.on_top("SM_Laptop", None, desk, 0.76)
        furnisher.on_top(
            ("SM_Globe", "SM_Papers", "SM_BookPile")[plan.pick(3)], None, below=desk, height=0.76, along=0.45
        )
    _desks(furnisher, front, depth)
    furnisher.wall_piece("SM_ShelfBook_B", furnisher.palette.wood, clearance=0.3)
    furnisher.dress(furnisher.wall_piece("SM_Sideboard", furnisher.palette.wood, clearance=0.3), _ON_CABINETS, 3)
    furnisher.small(("SM_TrashCan_A", "SM_Plant_A", "SM_Backpack"), 0.4)
    furnisher.hang("SM_ClockWall")
    furnisher.hang("SM_PinBoard", 1 + plan.pick(2))
    furnisher.hang("SM_WallMap", 2)
    furnisher.hang("SM_CardFrieze")


def _desks(furnisher: Furnisher, front: str, depth: float) -> None:
    """Places rows of desks for two pupils, each with two chairs, and aisles of at least 0.9 m."""
    plan, rng = furnisher.plan, furnisher.rng
    width = furnisher.length(front)
    columns = max(1, int((width - 0.8) // 2.05))
    rows = max(1, int((depth - 3.1) // 1.7))
    look, chair_look = plan.pick(12), plan.pick(5)
    for column in range(columns):
        for row in range(rows):
            along = (column + 0.5) * width / columns
            x, y = furnisher.at_wall(front, along, 3.2 + 1.7 * row)
            yaw = FACING[_OPPOSITE[front]] + math.pi
            desk = plan.place(furnisher.model("SM_TablePupil_F", look), x, y, yaw, furnisher.area, 0.3)
            if desk is None:
                continue
            if rng.random() < 0.35:
                furnisher.on_top(("SM_Papers", "SM_BookPile")[plan.pick(2)], None, below=desk, height=0.72, along=0.3)
            for shift in (-0.3, 0.3):
                if rng.random() < 0.88:
                    seat = (
                        x + 0.42 * math.sin(yaw) + shift * math.cos(yaw),
                        y - 0.42 * math.cos(yaw) + shift * math.sin(yaw),
                    )
                    turn = yaw + math.pi + float(rng.uniform(-0.15, 0.15))
                    chair = furnisher.model("SM_ChairWaiting_E", chair_look)
                    plan.seat(chair, seat[0], y=seat[1], yaw=turn, room=furnisher.area, of=desk)


def _library(furnisher: Furnisher) -> None:
    """Places book cases along the walls, a reading table, lounge chairs and a floor lamp."""
    for number in range(6):
        furnisher.wall_piece("SM_ShelfBook_B", furnisher.palette.wood + 4 * number, clearance=0.12)
    table = furnisher.plan.place(
        furnisher.model("SM_TableMeeting_B", furnisher.palette.wood), *furnisher.area.centre, 0.0, furnisher.area, 0.8
    )
    if table is not None:
        for side, shift in ((1.0, -0.4), (1.0, 0.4), (-1.0, 0.0)):
            yaw = 0.0 if side > 0 else math.pi
            x, y = table.x + shift, table.y + side * 0.55
            chair = furnisher.model("SM_ChairWood_D", furnisher.palette.wood)
            furnisher.plan.seat(chair, x, y=y, yaw=yaw, room=furnisher.area, of=table)
        furnisher.on_top("SM_Laptop", None, below=table, height=0.75, along=0.5)
        furnisher.on_top("SM_Monitor_A", None, below=table, height=0.75, along=-0.45)
    furnisher.carpet(
        (furnisher.area.x0 + 0.3 * furnisher.area.width, furnisher.area.y0 + 0.3 * furnisher.area.depth), 2.2, 2.2
    )
    for _ in range(2):
        furnisher.wall_piece("SM_ChairLounge_G", furnisher.palette.cover, clearance=0.4)
    furnisher.corner("SM_LampFloor")
    furnisher.corner("SM_Plant_A")
    furnisher.small(("SM_Ottoman", "SM_TrashCan_A"), 0.4)
    furnisher.hang("SM_WallMap")


def _computing(furnisher: Furnisher) -> None:
    """Places desks with screens and computers along the walls, a copier and a whiteboard."""
    furnisher.wall_piece("SM_Whiteboard_A", clearance=0.2)
    for _ in range(6):
        desk = furnisher.wall_piece("SM_TableDesk_A", furnisher.palette.wood, clearance=0.25, gap=0.05)
        if desk is not None:
            furnisher.on_top("SM_Monitor_A", None, desk, 0.745)
            furnisher.before("SM_ChairOffice_A", furnisher.palette.cover, desk, 0.55)
    furnisher.small(("SM_Copier", "SM_ComputerCase", "SM_ComputerCase", "SM_Fan", "SM_TrashCan_A"), 0.35)


def _staff(furnisher: Furnisher) -> None:
    """Places a table with chairs, a sofa, a copier, a kitchen unit with a coffee machine and lockers."""
    unit = furnisher.wall_piece("SM_KitchenUnit", furnisher.palette.wood, clearance=0.1)
    if unit is not None:
        furnisher.on_top("SM_CoffeeMachine", None, unit, 0.90)
    furnisher.wall_piece("SM_Sofa_A", furnisher.palette.cover, clearance=0.4)
    table = furnisher.plan.place(furnisher.model("SM_TableRound_C"), *furnisher.area.centre, 0.0, furnisher.area, 0.7)
    for turn in (0.4, 2.5, 4.6):
        if table is not None:
            furnisher.facing(table, "SM_ChairWood_D", furnisher.palette.wood, turn=turn, reach=0.6)
    furnisher.dress(table, ("SM_Crockery", "SM_FruitBowl", "SM_Papers"), 1, 0.74)
    desk = furnisher.wall_piece("SM_TableDesk_A", furnisher.palette.wood, clearance=0.4, gap=0.05)
    if desk is not None:
        furnisher.on_top("SM_Monitor_A", None, desk, 0.745)
        furnisher.on_top(
            ("SM_Papers", "SM_BookPile")[furnisher.plan.pick(2)], None, below=desk, height=0.745, along=0.42
        )
        furnisher.before("SM_ChairOffice_A", None, desk, 0.5)
    furnisher.wall_piece("SM_Locker", clearance=0.2)
    furnisher.small(("SM_Copier", "SM_WaterDispenser", "SM_TrashCan_A", "SM_Plant_A"), 0.35)
    furnisher.carpet(furnisher.area.centre, 2.2, 1.8, 1)
    furnisher.hang("SM_CoatHooks")
    furnisher.hang("SM_WallLedge")
    furnisher.hang("SM_PictureFrame", 3)


def _wash(furnisher: Furnisher) -> None:
    """Places basins, toilets and a bin."""
    for _ in range(2):
        furnisher.wall_piece("SM_Toilet", clearance=0.3, gap=0.0)
        furnisher.wall_piece("SM_WashBasin", furnisher.palette.cover, clearance=0.25, gap=0.0)
    furnisher.small(("SM_TrashCan_A",), 0.3)


def _hall(furnisher: Furnisher) -> None:
    """Places lockers, benches, bags, a bicycle, a vending machine, cones and extinguishers."""
    for number in range(4):
        furnisher.wall_piece("SM_Locker", furnisher.palette.cover, ("NS", "SN")[number % 2], clearance=0.25)
    furnisher.wall_piece("SM_VendingMachine", clearance=0.4)
    furnisher.wall_piece("SM_Bench", furnisher.palette.wood, clearance=0.4)
    furnisher.wall_piece("SM_Bench", furnisher.palette.wood, clearance=0.4)
    furnisher.wall_piece("SM_Bicycle", clearance=0.3, gap=0.1)
    furnisher.small(
        (
            "SM_Backpack",
            "SM_Backpack",
            "SM_TrashCan_A",
            "SM_TrafficCone",
            "SM_WaterDispenser",
            "SM_FireExtinguisher_02",
        ),
        0.45,
    )
    furnisher.hang("SM_ClockWall")
    furnisher.hang("SM_PinBoard", 2)
    furnisher.hang("SM_CoatHooks", 2)
    furnisher.hang("SM_WallMap", 2)
