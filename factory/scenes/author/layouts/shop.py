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
        _looks(palette),
        palette.trim,
        leaf=palette.leaf,
        ceiling=ceiling,
        views=palette.views,
        height=float(plan.rng.uniform(2.9, 3.4)),
    )
    rooms = build_rooms(plan, _divide(plan), building)
    furnishers = [Furnisher(plan, room, palette) for room in rooms]
    for each in furnishers:
        {"sales": _sales, "annex": _annex, "store": _store, "office": _office, "wash": _wash}[each.room.kind](
            each, trade
        )
    complete(plan, furnishers, _ON_SALE, ("sales", "annex"))
    complete(plan, furnishers, _STORED, ("store", "sales"))
    for each in furnishers:
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


def _sales(furnisher: Furnisher, trade: str) -> None:
    """Places checkouts near a wall, cold cases along the walls, rows of goods in the middle, carts and baskets."""
    plan = furnisher.plan
    for name in ("SM_FreezerUpright", "SM_ClothesRail"):
        furnisher.wall_piece(name, furnisher.palette.cover, clearance=0.3, gap=0.1)
    for _ in range(2 if furnisher.area.width * furnisher.area.depth > 95 else 1):
        counter = furnisher.wall_piece("SM_CounterCheckout", None, clearance=0.9, gap=1.0)
        if counter is not None:
            furnisher.before("SM_Stool_F", 0, counter, -0.62)
    if trade == "grocery":
        for _ in range(4):
            furnisher.wall_piece("SM_FreezerUpright", furnisher.palette.cover, clearance=0.02)
    furnisher.wall_piece("SM_VendingMachine", clearance=0.2)
    furnisher.wall_piece("SM_ShelfShop_C", furnisher.palette.wood, clearance=0.05)
    _rows(furnisher, trade)
    furnisher.small(("SM_Cart", "SM_Cart", "SM_Basket", "SM_TrashCan_A", "SM_Plant_A", "SM_StepLadder"), 0.4)
    if trade == "clothes":
        for _ in range(3):
            furnisher.wall_piece("SM_Mannequin", clearance=0.4, gap=0.2)
        furnisher.small(("SM_Mirror", "SM_Mirror", "SM_Bench"), 0.5)
    for _ in range(2):
        furnisher.wall_piece("SM_ShelfShop_C", furnisher.palette.wood, clearance=0.05)
    furnisher.hang("SM_OfferPlate", 5)
    furnisher.hang("SM_PictureFrame", 2)
    furnisher.hang("SM_ClockWall")
    _decorate(furnisher)
    plan.top_up("SM_FireExtinguisher_02", 2, [furnisher.area], "NESW")


def _decorate(furnisher: Furnisher) -> None:
    """Hangs lines with pennants below the ceiling in half of the shops, and lays a mat."""
    if furnisher.rng.random() < 0.5:
        look, yaw = furnisher.plan.pick(6), 0.0 if furnisher.area.width > furnisher.area.depth else math.pi / 2
        for share in (0.25, 0.5, 0.75):
            x = furnisher.area.x0 + (share if yaw else 0.5) * furnisher.area.width
            y = furnisher.area.y0 + (0.5 if yaw else share) * furnisher.area.depth
            furnisher.plan.add(furnisher.model("SM_Pennants", look), x, y, yaw)
    side = next(iter(furnisher.room.doors), "S")
    along = (
        furnisher.room.doors[side][0] - (furnisher.area.x0 if side in "NS" else furnisher.area.y0)
        if furnisher.room.doors
        else 2.0
    )
    furnisher.carpet(furnisher.at_wall(side, along, 0.7), 1.2, 1.2)


def _rows(furnisher: Furnisher, trade: str) -> None:
    """Places rows of goods along one side, with aisles of 1.5 to 2.1 m. Rows of more than 8 m have a cross aisle."""
    plan, rng, area = furnisher.plan, furnisher.rng, furnisher.area
    is_along_x = bool(rng.random() < (0.7 if area.width > area.depth else 0.3))
    length, depth = (area.width, area.depth) if is_along_x else (area.depth, area.width)
    kinds, margin, aisle = _GOODS[trade], float(rng.uniform(1.7, 2.1)), float(rng.uniform(*_AISLE_M))
    row, v = 0, margin + 0.45
    while v < depth - margin - 0.4:
        kind = kinds[row % 3] if trade != "household" else kinds[plan.pick(3)]
        look, u = plan.pick(6), margin
        gap = float(rng.uniform(0.35, 0.65)) * length
        while u < length - margin:
            model = furnisher.model(kind, 3 + look % 3 if kind == "SM_ShelfShop_C" else look)
            width = float(model.high[0] - model.low[0])
            is_cross_aisle = length > 8.0 and gap - 0.8 < u + width / 2 < gap + 0.8
            if u + width < length - margin and not is_cross_aisle:
                x, y = (area.x0 + u + width / 2, area.y0 + v) if is_along_x else (area.x0 + v, area.y0 + u + width / 2)
                plan.place(model, x, y, 0.0 if is_along_x else math.pi / 2, area, 0.0)
            u += width + (0.0 if kind.startswith("SM_Shelf") else 0.35)
        row, v = row + 1, v + 0.85 + aisle


def _annex(furnisher: Furnisher, trade: str) -> None:
    """Furnishes a second sales room: with clothes rails in a clothes shop, otherwise with a coffee corner."""
    if trade == "clothes":
        for _ in range(4):
            furnisher.wall_piece("SM_ClothesRail", clearance=0.5, gap=0.15)
        furnisher.small(("SM_Mirror", "SM_Bench"), 0.5)
    else:
        table = furnisher.plan.place(
            furnisher.model("SM_TableRound_C"), *furnisher.area.centre, 0.0, furnisher.area, 0.8
        )
        for turn in (0.4, 2.5, 4.6) if table is not None else ():
            x, y = furnisher.area.centre[0] + 0.6 * math.cos(turn), furnisher.area.centre[1] + 0.6 * math.sin(turn)
            chair = furnisher.model("SM_ChairWaiting_E", furnisher.palette.cover)
            furnisher.plan.place(chair, x, y, turn - math.pi / 2, furnisher.area, 0.0, True)
        furnisher.dress(table, ("SM_Crockery", "SM_Bouquet", "SM_Tray"), 1, 0.74)
        furnisher.carpet(furnisher.area.centre, 2.4, 2.4, 1)
        counter = furnisher.wall_piece("SM_CounterIsland", clearance=0.6)
        if counter is not None:
            furnisher.on_top("SM_CoffeeMachine", None, below=counter, height=0.92, along=0.3)
        furnisher.wall_piece("SM_FreezerUpright", furnisher.palette.cover, clearance=0.1)
    for _ in range(2):
        furnisher.wall_piece("SM_ShelfShop_C", furnisher.palette.wood, clearance=0.1)
    furnisher.wall_piece("SM_VendingMachine", clearance=0.3)
    furnisher.corner("SM_Plant_A")
    furnisher.small(("SM_TrashCan_A", "SM_Mannequin"), 0.5)
    furnisher.hang("SM_OfferPlate", 2)
    furnisher.hang("SM_PictureFrame", 3)


def _store(furnisher: Furnisher, _trade: str) -> None:
    """Places steel shelves, cartons, crates, a ladder and a trolley."""
    for number in range(3):
        furnisher.wall_piece("SM_ShelfSteel_A", number, clearance=0.1)
    furnisher.small(
        ("SM_CartonSingle", "SM_CartonSingle", "SM_CratePlastic_A", "SM_StepLadder", "SM_Cart", "SM_CartonSingle"), 0.3
    )
    furnisher.wall_piece("SM_Locker", clearance=0.2)


def _office(furnisher: Furnisher, _trade: str) -> None:
    """Places a desk with a monitor, a chair, a book case, a copier and a cabinet."""
    desk = furnisher.wall_piece("SM_TableDesk_A", furnisher.palette.wood, clearance=0.5, gap=0.05)
    if desk is not None:
        furnisher.on_top("SM_Monitor_A", None, desk, 0.745)
        furnisher.before("SM_ChairOffice_A", None, desk, 0.5)
        furnisher.on_top(
            ("SM_Papers", "SM_Portrait")[furnisher.plan.pick(2)], None, below=desk, height=0.745, along=0.42
        )
    furnisher.dress(
        furnisher.wall_piece("SM_Sideboard", furnisher.palette.wood, clearance=0.3),
        ("SM_Papers", "SM_BookRow", "SM_Kettle"),
    )
    furnisher.small(("SM_Copier", "SM_WaterDispenser", "SM_Plant_A", "SM_TrashCan_A"), 0.4)
    furnisher.hang("SM_CoatHooks")
    furnisher.hang("SM_WallLedge")
    furnisher.hang("SM_PictureFrame", 2)


def _wash(furnisher: Furnisher, _trade: str) -> None:
    """Places a toilet, a basin and a basket."""
    furnisher.wall_piece("SM_Toilet", clearance=0.3, gap=0.0)
    furnisher.wall_piece("SM_WashBasin", clearance=0.3, gap=0.0)
    furnisher.small(("SM_TrashCan_A", "SM_Basket"), 0.2)
