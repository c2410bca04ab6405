"""Layout of the family `home`: five to nine rooms, with or without a hall, with seeded sizes, doors, furniture, style.

Lengths in metres. Places larger props first. Does not build walls.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from numpy.random import Generator

from factory.scenes.author.circulation import RoomSpec, no_hall, straight_hall
from factory.scenes.author.dwelling import BuildingLook, BuiltRoom, RoomLook, build_rooms
from factory.scenes.author.furnisher import Furnisher, complete, kitchen_row
from factory.scenes.author.partition import Division, Doors, divide_floor
from factory.scenes.author.placement import FACING, FloorPlan, PropPlacement, Rectangle
from factory.scenes.author.style import Palette, draw_palette

_EVERYWHERE = {
    "SM_Sofa_A": 1,
    "SM_Wardrobe": 1,
    "SM_Dresser": 1,
    "SM_Sideboard": 1,
    "SM_ChairWood_D": 1,
    "SM_Plant_A": 2,
    "SM_ShelfBook_B": 2,
    "SM_LampFloor": 1,
    "SM_Vase": 2,
    "SM_Ottoman": 2,
    "SM_TrashCan_A": 2,
    "SM_Basket": 2,
    "SM_Mirror": 2,
    "SM_Suitcase": 2,
}
"""Pieces that every home has, with their minimum numbers."""


_ON_BOARDS = (
    "SM_BookRow", "SM_BookPile", "SM_Bouquet", "SM_Candles", "SM_Portrait", "SM_FruitBowl", "SM_Tray", "SM_Globe",
)  # fmt: skip
_ON_TABLES = ("SM_Crockery", "SM_FruitBowl", "SM_Bouquet", "SM_Candles", "SM_Tray", "SM_Papers")
_ON_DRESSERS = ("SM_Portrait", "SM_BookPile", "SM_Flasks", "SM_Bouquet", "SM_Candles")
"""Small things on low cabinets, tables and chests of drawers."""
_LEAST_TOP_M2 = 0.08
"""A part of a piece of furniture counts as the top only if its bounding rectangle in plan is larger than this, square
metres."""
_UNITS = ("SM_SinkUnit", "SM_Dishwasher", "SM_KitchenUnit", "SM_Oven", "SM_KitchenUnit")


def furnish_home(plan: FloorPlan, rooms: Sequence[BuiltRoom], palette: Palette) -> None:
    kinds: dict[str, Callable[[Furnisher], None]] = {
        "living": _living,
        "dining": _dining,
        "kitchen": _kitchen,
        "bedroom": _bedroom,
        "bath": _bath,
        "study": _study,
        "laundry": _laundry,
        "hall": _hall,
    }
    has = {room.kind for room in rooms}
    furnishers = [Furnisher(plan, room, palette) for room in rooms]
    for furnisher in furnishers:
        room = furnisher.room
        kinds[room.kind](furnisher)
        if room.kind == "living" and "dining" not in has:
            _dining_group(furnisher, along_wall=True)
        if room.kind == "bath" and "laundry" not in has:
            furnisher.wall_piece("SM_WashingMachine", plan.pick(3), clearance=0.05)
    dry = ("living", "dining", "bedroom", "study", "hall")
    complete(plan, furnishers, {"SM_NightStand": 1}, ("bedroom",))
    complete(plan, furnishers, {"SM_BathTub": 1, "SM_Toilet": 1}, ("bath",))
    complete(plan, furnishers, {"SM_Refrigerator": 1}, ("kitchen", "laundry", "dining", "hall", "living"))
    complete(plan, furnishers, {"SM_WashingMachine": 1}, ("laundry", "bath", "kitchen", "hall"))
    complete(plan, furnishers, _EVERYWHERE, dry)
    for furnisher in furnishers:
        furnisher.hang_all()


def _living(furnisher: Furnisher) -> None:
    """Places a sofa opposite a television, arm chairs, a table on a rug, shelves, sometimes a fireplace or a piano."""
    plan, rng, look = furnisher.plan, furnisher.rng, furnisher.palette.wood
    sides = furnisher.sides()
    for side, clearance in [(side, clearance) for clearance in (0.3, 0.05) for side in sides]:
        media = furnisher.wall_piece("SM_TvUnit", look, sides=side, clearance=clearance, gap=0.02)
        if media is not None:
            furnisher.on_top("SM_TelevisionFlat", plan.pick(3), media, float(media.model.high[2]))
            _seats(furnisher, side, media)
            break
    if rng.random() < 0.6:
        furnisher.wall_piece("SM_Fireplace", clearance=0.4, gap=0.0)
    furnisher.wall_piece("SM_ShelfBook_B", look, clearance=0.3)
    if rng.random() < 0.5:
        piano = furnisher.wall_piece("SM_Piano", clearance=0.35)
        if piano is not None:
            furnisher.before("SM_Stool_F", 1, piano, 0.55)
    furnisher.corner("SM_LampFloor")
    furnisher.corner("SM_Plant_A")
    furnisher.corner("SM_Plant_A")
    furnisher.dress(furnisher.wall_piece("SM_Sideboard", look + 1, clearance=0.3), _ON_BOARDS, 3)
    furnisher.small(("SM_Vase", "SM_Basket", "SM_ClockTall", "SM_ToyPile")[plan.pick(2) :: 2])
    furnisher.hang(("SM_Tapestry", "SM_WallLedge")[plan.pick(2)])
    furnisher.hang("SM_PictureFrame", 4)


def _seats(furnisher: Furnisher, side: str, media: PropPlacement) -> None:
    """Places a sofa that faces the television cabinet, with a rug, a coffee table, arm chairs and an ottoman."""
    plan, rng, cover = furnisher.plan, furnisher.rng, furnisher.palette.cover
    reach = min(float(rng.uniform(2.5, 3.1)), (furnisher.area.depth if side in "NS" else furnisher.area.width) - 0.9)
    into = (math.sin(media.yaw), -math.cos(media.yaw))
    x, y = media.x + into[0] * reach, media.y + into[1] * reach
    middle = (media.x + into[0] * (reach - 1.15), media.y + into[1] * (reach - 1.15))
    if plan.place(plan.props.model("SM_Sofa_A", cover), x, y, media.yaw + math.pi, furnisher.area, 0.1) is None:
        furnisher.wall_piece("SM_Sofa_A", cover, clearance=0.3)
    furnisher.carpet(middle, *((2.5, 1.7) if side in "NS" else (1.7, 2.5)))
    along = (math.cos(media.yaw), math.sin(media.yaw))
    plan.place(plan.props.model("SM_TableCoffee_D", furnisher.palette.wood), *middle, media.yaw, furnisher.area, 0.1)
    for turn in (1.0, -1.0) if rng.random() < 0.5 else (-1.0, 1.0):
        shift = turn * float(rng.uniform(1.45, 1.7))
        seat = (middle[0] + along[0] * shift, middle[1] + along[1] * shift)
        model = plan.props.model("SM_ChairLounge_G", cover + 1)
        plan.place(model, *seat, media.yaw + turn * math.pi / 2 + math.pi, furnisher.area, 0.15)
        if rng.random() < 0.5:
            break
    furnisher.small(("SM_Ottoman",), 0.3)


def _dining(furnisher: Furnisher) -> None:
    """Places a table with chairs, a sideboard, a plant and pictures."""
    _dining_group(furnisher, along_wall=False)
    board = furnisher.wall_piece("SM_Sideboard", furnisher.palette.wood, clearance=0.5)
    furnisher.dress(board, ("SM_LampSmall", *_ON_BOARDS), 3)
    furnisher.corner("SM_Plant_A")
    furnisher.small(("SM_ClockTall", "SM_Vase") if furnisher.rng.random() < 0.5 else ("SM_Vase",))
    furnisher.hang("SM_WallLedge")
    furnisher.hang("SM_PictureFrame", 3)


def _dining_group(furnisher: Furnisher, along_wall: bool) -> None:
    """Places a dining table with four chairs in the middle of a room, or near a wall of a larger room."""
    plan, rng = furnisher.plan, furnisher.rng
    table = plan.props.model("SM_TableDining_E", furnisher.palette.wood)
    kind, look = (("SM_ChairWood_D", furnisher.palette.wood), ("SM_ChairWaiting_E", furnisher.palette.cover))[
        plan.pick(2)
    ]
    for _ in range(14):
        margin = 1.5 if along_wall else 1.9
        x = float(rng.uniform(furnisher.area.x0 + margin, max(furnisher.area.x1 - margin, furnisher.area.x0 + margin)))
        y = float(rng.uniform(furnisher.area.y0 + margin, max(furnisher.area.y1 - margin, furnisher.area.y0 + margin)))
        if not along_wall:
            x, y = 0.6 * furnisher.area.centre[0] + 0.4 * x, 0.6 * furnisher.area.centre[1] + 0.4 * y
        yaw = 0.0 if furnisher.area.width >= furnisher.area.depth else math.pi / 2
        placed = plan.place(table, x, y, yaw, furnisher.area, 0.75)
        if placed is not None:
            _chairs(furnisher, placed, kind, look)
            furnisher.dress(placed, _ON_TABLES, 3)
            if not along_wall:
                furnisher.carpet((x, y), *((2.6, 1.8) if yaw == 0.0 else (1.8, 2.6)), 1)
            return


def _chairs(furnisher: Furnisher, table: PropPlacement, kind: str, look: int) -> None:
    """Places two chairs on each long side of a table, and one at its end."""
    c, s = math.cos(table.yaw), math.sin(table.yaw)
    half = float(table.model.high[1])
    seats = [(a, side * (half + 0.10), 0.0 if side > 0 else math.pi) for a in (-0.33, 0.33) for side in (-1, 1)]
    seats.append((float(table.model.high[0]) + 0.16, 0.0, -math.pi / 2))
    for a, b, turn in seats:
        if furnisher.rng.random() < 0.86:
            x, y = table.x + c * a - s * b, table.y + s * a + c * b
            yaw = table.yaw + turn + float(furnisher.rng.uniform(-0.15, 0.15))
            furnisher.plan.seat(furnisher.plan.props.model(kind, look), x, y=y, yaw=yaw, room=furnisher.area, of=table)


def _kitchen(furnisher: Furnisher) -> None:
    """Places a row of units with sink, oven, dishwasher and refrigerator, and an island or a table if it fits."""
    plan, look = furnisher.plan, furnisher.palette.wood
    sides = furnisher.sides()
    main = kitchen_row(furnisher, sides, look=look, names=_UNITS, tops=("SM_Microwave", "SM_CoffeeMachine"))
    rest = "".join(side for side in sides if side != main)
    if main is None:
        for name in ("SM_SinkUnit", "SM_Oven", "SM_Dishwasher"):
            furnisher.wall_piece(name, look, clearance=0.02)
    if furnisher.wall_piece("SM_Refrigerator", None, rest, 0.05) is None:
        furnisher.wall_piece("SM_Refrigerator", None, clearance=0.0)
    space = min(furnisher.area.width, furnisher.area.depth)
    if furnisher.rng.random() < 0.5 and space > 4.0:
        plan.place(
            furnisher.model("SM_CounterIsland", look), *furnisher.area.centre, FACING[main or "N"], furnisher.area, 0.9
        )
    elif space > 3.3:
        table = plan.place(furnisher.model("SM_TableRound_C"), *furnisher.area.centre, 0.0, furnisher.area, 0.8)
        for turn in (0.4, 3.5):
            if table is not None:
                furnisher.facing(table, "SM_ChairWood_D", look, turn=turn, reach=0.55)
        furnisher.dress(table, _ON_TABLES, 1, 0.74)
    furnisher.small(("SM_TrashCan_A", "SM_Basket"), 0.3)
    furnisher.hang("SM_WallLedge")
    furnisher.hang("SM_PictureFrame")


def _bedroom(furnisher: Furnisher) -> None:
    """Places a bed with its head at a wall, night stands, a wardrobe, a dresser, a lounge chair and a rug."""
    plan, rng, look = furnisher.plan, furnisher.rng, furnisher.palette.wood
    variant = look + plan.pick(3)
    tries = (furnisher.wall_piece("SM_BedDouble", variant, clearance=free_m, gap=0.01) for free_m in (0.75, 0.4, 0.1))
    bed_placed = next((bed for bed in tries if bed is not None), None)
    if bed_placed is not None:
        half = float(bed_placed.model.high[0])
        for turn in (-1.0, 1.0):
            stand = furnisher.beside("SM_NightStand", look, bed_placed, turn * (half + 0.32), 0.02)
            if stand is not None and rng.random() < 0.7:
                furnisher.on_top("SM_LampSmall", look, below=stand, height=_top_of(stand), along=-0.08, back=0.06)
        size = (2.7, 1.5) if abs(math.cos(bed_placed.yaw)) > 0.5 else (1.5, 2.7)
        furnisher.carpet((bed_placed.x, bed_placed.y), *size, plan.pick(9) + 2)
    if furnisher.wall_piece("SM_Wardrobe", look, clearance=0.5) is None:
        furnisher.wall_piece("SM_Wardrobe", look, clearance=0.1)
    furnisher.dress(furnisher.wall_piece("SM_Dresser", look, clearance=0.45), _ON_DRESSERS, 2)
    extra = ("SM_ChairLounge_G", "SM_Ottoman", "SM_Bench", "SM_ShelfBook_B")[plan.pick(4)]
    furnisher.wall_piece(extra, furnisher.palette.cover, clearance=0.45)
    furnisher.small(
        (("SM_Suitcase", "SM_Basket"), ("SM_Backpack", "SM_Basket"), ("SM_Mirror", "SM_Fan"))[plan.pick(3)], 0.3
    )
    furnisher.hang(("SM_Tapestry", "SM_WallLedge", "SM_PictureFrame")[plan.pick(3)])
    furnisher.hang("SM_PictureFrame", 2)


def _top_of(piece: PropPlacement) -> float:
    """Returns the height of a piece without the small things on it, metres."""
    boxes = [(part.mesh.points.min(axis=0), part.mesh.points.max(axis=0)) for part in piece.model.pieces]
    return max(float(high[2]) for low, high in boxes if (high - low)[:2].prod() > _LEAST_TOP_M2)


def _bath(furnisher: Furnisher) -> None:
    """Places a bathtub, a toilet, a basin, a basket and a towel rail."""
    plan = furnisher.plan
    furnisher.wall_piece("SM_BathTub", plan.pick(3), clearance=0.2, gap=0.02)
    furnisher.wall_piece("SM_WashBasin", plan.pick(3), clearance=0.15, gap=0.0)
    furnisher.wall_piece("SM_Toilet", plan.pick(3), clearance=0.2, gap=0.0)
    furnisher.small(("SM_Basket", "SM_TrashCan_A"), 0.15)
    furnisher.carpet(furnisher.area.centre, 0.9, 0.6, plan.pick(12))
    furnisher.hang("SM_TowelRail")
    furnisher.hang("SM_WallLedge")


def _study(furnisher: Furnisher) -> None:
    """Places a desk with a monitor and a chair, book cases and an arm chair."""
    plan, look = furnisher.plan, furnisher.palette.wood
    desk = furnisher.wall_piece("SM_TableDesk_A", look, clearance=0.5, gap=0.05)
    if desk is not None:
        furnisher.on_top("SM_Monitor_A", plan.pick(3), desk, 0.745)
        furnisher.on_top("SM_LampSmall", plan.pick(4), below=desk, height=0.745, along=0.5)
        furnisher.before("SM_ChairOffice_A", None, desk, 0.5)
    for number in range(2):
        furnisher.dress(
            furnisher.wall_piece("SM_ShelfBook_B", look + number, clearance=0.3), ("SM_Globe", "SM_BookPile"), 1
        )
    furnisher.wall_piece("SM_ChairLounge_G", furnisher.palette.cover, clearance=0.4)
    furnisher.small(("SM_TrashCan_A", "SM_Plant_A"), 0.4)
    furnisher.carpet(furnisher.area.centre, 1.6, 1.2, 2)
    furnisher.hang("SM_WallLedge")
    furnisher.hang("SM_PictureFrame", 2)


def _laundry(furnisher: Furnisher) -> None:
    """Places washing machines, a basket, a cabinet and a fan."""
    plan = furnisher.plan
    first = furnisher.wall_piece("SM_WashingMachine", plan.pick(3), clearance=0.05)
    if first is not None:
        furnisher.dress(first, ("SM_Flasks",), 1)
        furnisher.beside("SM_WashingMachine", plan.pick(3), first, 0.62, 0.02)
    furnisher.wall_piece("SM_Wardrobe", furnisher.palette.wood + 1, clearance=0.3)
    furnisher.small(("SM_Basket", "SM_Basket", "SM_Fan"), 0.25)


def _hall(furnisher: Furnisher) -> None:
    """Places a bench, a mirror, bags and a plant along the walls of a hall whose middle stays free."""
    plan = furnisher.plan
    furnisher.small(("SM_Backpack", "SM_Suitcase", "SM_Vase")[plan.pick(2) :], 0.5)
    if min(furnisher.area.width, furnisher.area.depth) > 1.9:
        furnisher.small(("SM_Mirror",), 0.5)
    furnisher.corner("SM_Plant_A")
    length = 0.8 * max(furnisher.area.width, furnisher.area.depth)
    furnisher.carpet(
        furnisher.area.centre,
        *((length, 0.8) if furnisher.area.width > furnisher.area.depth else (0.8, length)),
        plan.pick(12),
    )
    furnisher.hang("SM_CoatHooks")
    furnisher.hang("SM_PictureFrame", 3)


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
        leaf=palette.leaf,
        ceiling=palette.ceiling,
        views=palette.views,
        height=float(plan.rng.choice((2.5, 2.6, 2.75, 2.9))),
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
    return divide_floor(rng, outline, specs=specs, doors=doors, scheme=straight_hall(hall) if hall else no_hall)


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
