"""Layout of the family `shop`: a sales floor with rows of shelves or clothes, a store room, an office, a wash room.

The seed determines the kind of shop (grocery, clothes or household), the sales floor, the rows and the style.
"""

from __future__ import annotations

import math

from factory.scenes.author.circulation import RoomSpec
from factory.scenes.author.dwelling import BuildingLook, RoomLook, build_rooms
from factory.scenes.author.furnisher import Furnisher, complete
from factory.scenes.author.partition import Division, Doors, divide_floor
from factory.scenes.author.placement import FloorPlan, Rectangle
from factory.scenes.author.style import PUBLIC, Palette, draw_palette

_GOODS = {
    "grocery": ("SM_ShelfShop_C", "SM_ShelfShop_C", "SM_ProduceStand"),
    "clothes": ("SM_ClothesRail", "SM_ClothesRail", "SM_TableMeeting_B"),
    "household": ("SM_ShelfShop_C", "SM_ShelfSteel_A", "SM_ClothesRail"),
}
_ON_SALE = {
    "SM_CounterCheckout": 1, "SM_FreezerUpright": 1, "SM_VendingMachine": 1, "SM_ShelfShop_C": 1, "SM_ClothesRail": 1,
    "SM_Mannequin": 1, "SM_TableRound_C": 1, "SM_ChairWaiting_E": 2, "SM_Plant_A": 1, "SM_TrashCan_A": 1,
}  # fmt: skip
_STORED = {
    "SM_CartonSingle": 2,
    "SM_CratePlastic_A": 2,
    "SM_StepLadder": 1,
    "SM_Cart": 1,
    "SM_Basket": 1,
    "SM_Locker": 1,
}
"""Pieces that every shop has, whatever it sells, with their minimum numbers."""
_AISLE_M = (1.5, 2.1)


def lay_out_shop(plan: FloorPlan) -> None:
    """Builds the rooms, then furnishes them.

    Raises:
        WorldError: no division of the floor into the chosen rooms was found; another seed may have one.
    """
    palette = draw_palette(plan.rng, PUBLIC)
    trade = tuple(_GOODS)[plan.pick(3)]
    ceiling = ("panels", "panels", "boards", "beams")[plan.pick(4)]
    building = BuildingLook(
        _looks(palette), palette.trim, palette.leaf, ceiling, palette.views, float(plan.rng.uniform(2.9, 3.4))
    )
    rooms = build_rooms(plan, _divide(plan), building)
    own = [Furnisher(plan, room, palette) for room in rooms]
    for each in own:
        {"sales": _sales, "annex": _annex, "store": _store, "office": _office, "wash": _wash}[each.room.kind](
            each, trade
        )
    complete(plan, own, _ON_SALE, ("sales", "annex"))
    complete(plan, own, _STORED, ("store", "sales"))
    for each in own:
        each.hang_all()


def _divide(plan: FloorPlan) -> Division:
    rng = plan.rng
    specs = [
        RoomSpec("sales", float(rng.uniform(85, 130)), 7.0, True),
        RoomSpec("store", float(rng.uniform(26, 36)), 3.6, True),
        RoomSpec("office", float(rng.uniform(15, 21)), 2.9),
        RoomSpec("wash", float(rng.uniform(10, 13)), 2.4),
    ]
    if rng.random() < 0.6:
        specs.append(RoomSpec("annex", float(rng.uniform(34, 52)), 4.2, True))
    area, ratio = sum(spec.area_m2 for spec in specs), float(rng.uniform(1.0, 1.5))
    width = math.sqrt(area * ratio)
    doors = Doors(float(rng.uniform(1.15, 1.4)), {frozenset(("sales", "annex")): (2.4, 4.0)}, 0.6)
    return divide_floor(rng, Rectangle(0.0, 0.0, width, area / width), specs, doors)


def _looks(palette: Palette) -> dict[str, RoomLook]:
    return {
        "sales": RoomLook(palette.stone, palette.paints[0], 3),
        "annex": RoomLook(palette.boards, palette.paints[1], 2),
        "store": RoomLook(palette.stone, palette.paints[2], 0),
        "office": RoomLook(palette.pile, palette.paints[3], 1, palette.curtain),
        "wash": RoomLook(palette.stone, palette.tiles, 0),
    }


def _sales(own: Furnisher, trade: str) -> None:
    """Places checkouts near a wall, cold cases along the walls, rows of goods in the middle, carts and baskets."""
    plan = own.plan
    for name in ("SM_FreezerUpright", "SM_ClothesRail"):
        own.wall_piece(name, own.palette.cover, clearance=0.3, gap=0.1)
    for _ in range(2 if own.area.width * own.area.depth > 95 else 1):
        found = own.wall_piece("SM_CounterCheckout", None, clearance=0.9, gap=1.0)
        if found is not None:
            own.before("SM_Stool_F", 0, found, -0.62)
    if trade == "grocery":
        for _ in range(4):
            own.wall_piece("SM_FreezerUpright", own.palette.cover, clearance=0.02)
    own.wall_piece("SM_VendingMachine", clearance=0.2)
    own.wall_piece("SM_ShelfShop_C", own.palette.wood, clearance=0.05)
    _rows(own, trade)
    own.small(("SM_Cart", "SM_Cart", "SM_Basket", "SM_TrashCan_A", "SM_Plant_A", "SM_StepLadder"), 0.4)
    if trade == "clothes":
        for _ in range(3):
            own.wall_piece("SM_Mannequin", clearance=0.4, gap=0.2)
        own.small(("SM_Mirror", "SM_Mirror", "SM_Bench"), 0.5)
    for _ in range(2):
        own.wall_piece("SM_ShelfShop_C", own.palette.wood, clearance=0.05)
    own.hang("SM_OfferPlate", 5)
    own.hang("SM_PictureFrame", 2)
    own.hang("SM_ClockWall")
    _decorate(own)
    plan.top_up("SM_FireExtinguisher_02", 2, [own.area], "NESW")


def _decorate(own: Furnisher) -> None:
    """Hangs lines with pennants below the ceiling in half of the shops, and lays a mat."""
    if own.rng.random() < 0.5:
        look, yaw = own.plan.pick(6), 0.0 if own.area.width > own.area.depth else math.pi / 2
        for share in (0.25, 0.5, 0.75):
            x = own.area.x0 + (share if yaw else 0.5) * own.area.width
            y = own.area.y0 + (0.5 if yaw else share) * own.area.depth
            own.plan.add(own.model("SM_Pennants", look), x, y, yaw)
    side = next(iter(own.room.doors), "S")
    along = own.room.doors[side][0] - (own.area.x0 if side in "NS" else own.area.y0) if own.room.doors else 2.0
    own.carpet(own.at_wall(side, along, 0.7), 1.2, 1.2)


def _rows(own: Furnisher, trade: str) -> None:
    """Places rows of goods along one side, with aisles of 1.5 to 2.1 m. Rows of more than 8 m have a cross aisle."""
    plan, rng, area = own.plan, own.rng, own.area
    is_along_x = bool(rng.random() < (0.7 if area.width > area.depth else 0.3))
    length, depth = (area.width, area.depth) if is_along_x else (area.depth, area.width)
    kinds, margin, aisle = _GOODS[trade], float(rng.uniform(1.7, 2.1)), float(rng.uniform(*_AISLE_M))
    row, v = 0, margin + 0.45
    while v < depth - margin - 0.4:
        kind = kinds[row % 3] if trade != "household" else kinds[plan.pick(3)]
        look, u = plan.pick(6), margin
        gap = float(rng.uniform(0.35, 0.65)) * length
        while u < length - margin:
            model = own.model(kind, 3 + look % 3 if kind == "SM_ShelfShop_C" else look)
            width = float(model.high[0] - model.low[0])
            is_cross_aisle = length > 8.0 and gap - 0.8 < u + width / 2 < gap + 0.8
            if u + width < length - margin and not is_cross_aisle:
                x, y = (area.x0 + u + width / 2, area.y0 + v) if is_along_x else (area.x0 + v, area.y0 + u + width / 2)
                plan.place(model, x, y, 0.0 if is_along_x else math.pi / 2, area, 0.0)
            u += width + (0.0 if kind.startswith("SM_Shelf") else 0.35)
        row, v = row + 1, v + 0.85 + aisle


def _annex(own: Furnisher, trade: str) -> None:
    """Furnishes a second sales room: with clothes rails in a clothes shop, otherwise with a coffee corner."""
    if trade == "clothes":
        for _ in range(4):
            own.wall_piece("SM_ClothesRail", clearance=0.5, gap=0.15)
        own.small(("SM_Mirror", "SM_Bench"), 0.5)
    else:
        table = own.plan.place(own.model("SM_TableRound_C"), *own.area.centre, 0.0, own.area, 0.8)
        for turn in (0.4, 2.5, 4.6) if table is not None else ():
            x, y = own.area.centre[0] + 0.6 * math.cos(turn), own.area.centre[1] + 0.6 * math.sin(turn)
            chair = own.model("SM_ChairWaiting_E", own.palette.cover)
            own.plan.place(chair, x, y, turn - math.pi / 2, own.area, 0.0, True)
        own.dress(table, ("SM_Crockery", "SM_Bouquet", "SM_Tray"), 1, 0.74)
        own.carpet(own.area.centre, 2.4, 2.4, 1)
        counter = own.wall_piece("SM_CounterIsland", clearance=0.6)
        if counter is not None:
            own.on_top("SM_CoffeeMachine", None, counter, 0.92, 0.3)
        own.wall_piece("SM_FreezerUpright", own.palette.cover, clearance=0.1)
    for _ in range(2):
        own.wall_piece("SM_ShelfShop_C", own.palette.wood, clearance=0.1)
    own.wall_piece("SM_VendingMachine", clearance=0.3)
    own.corner("SM_Plant_A")
    own.small(("SM_TrashCan_A", "SM_Mannequin"), 0.5)
    own.hang("SM_OfferPlate", 2)
    own.hang("SM_PictureFrame", 3)


def _store(own: Furnisher, _trade: str) -> None:
    """Places steel shelves, cartons, crates, a ladder and a trolley."""
    for number in range(3):
        own.wall_piece("SM_ShelfSteel_A", number, clearance=0.1)
    own.small(
        ("SM_CartonSingle", "SM_CartonSingle", "SM_CratePlastic_A", "SM_StepLadder", "SM_Cart", "SM_CartonSingle"), 0.3
    )
    own.wall_piece("SM_Locker", clearance=0.2)


def _office(own: Furnisher, _trade: str) -> None:
    """Places a desk with a monitor, a chair, a book case, a copier and a cabinet."""
    desk = own.wall_piece("SM_TableDesk_A", own.palette.wood, clearance=0.5, gap=0.05)
    if desk is not None:
        own.on_top("SM_Monitor_A", None, desk, 0.745)
        own.before("SM_ChairOffice_A", None, desk, 0.5)
        own.on_top(("SM_Papers", "SM_Portrait")[own.plan.pick(2)], None, desk, 0.745, 0.42)
    own.dress(own.wall_piece("SM_Sideboard", own.palette.wood, clearance=0.3), ("SM_Papers", "SM_BookRow", "SM_Kettle"))
    own.small(("SM_Copier", "SM_WaterDispenser", "SM_Plant_A", "SM_TrashCan_A"), 0.4)
    own.hang("SM_CoatHooks")
    own.hang("SM_WallLedge")
    own.hang("SM_PictureFrame", 2)


def _wash(own: Furnisher, _trade: str) -> None:
    """Places a toilet, a basin and a basket."""
    own.wall_piece("SM_Toilet", clearance=0.3, gap=0.0)
    own.wall_piece("SM_WashBasin", clearance=0.3, gap=0.0)
    own.small(("SM_TrashCan_A", "SM_Basket"), 0.2)
