"""Layout of the family `hospital`: wards, treatment rooms, a waiting hall and service rooms along halls.

The kinds, sizes, order and doors of the rooms, the halls and the style differ by seed. Lengths in metres. Places larger
props first. Does not build walls.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from factory.scenes.author.circulation import HALL, RoomSpec, l_hall, ring_hall, spine_hall, t_hall
from factory.scenes.author.dwelling import BuildingLook, BuiltRoom, RoomLook, build_rooms
from factory.scenes.author.furnisher import Furnisher, complete, enter, kitchen_row, round_table, seat_group, workplace
from factory.scenes.author.materials import SurfaceMaterial, painted, tinted, wood
from factory.scenes.author.partition import Division, Doors, divide_floor, turned
from factory.scenes.author.placement import FACING, FloorPlan, PropPlacement, Rectangle
from factory.scenes.author.room import WALL_THICKNESS_M, Trim, marking
from factory.scenes.author.style import CLINIC, Palette, draw_palette

_EVERYWHERE = {"SM_FireExtinguisher_02": 4, "SM_Whiteboard_A": 4, "SM_TrashCan_A": 5, "SM_ChairWaiting_E": 4}
"""Pieces that every hospital has, with their minimum numbers."""
_OPPOSITE = {"N": "S", "S": "N", "E": "W", "W": "E"}
_SEATS = ("SM_ChairWaiting_E", "SM_ChairVisitor_C")
_BED_GAP_M = 0.1
_SEAT_PITCH_M = 0.66
_SIGNED = ("ward", "exam", "consulting")
"""Rooms with a sign above their doors."""


def furnish_hospital(plan: FloorPlan, rooms: Sequence[BuiltRoom], palette: Palette, clutter: float) -> None:
    """Furnishes every room by its kind; `clutter` is the probability of each small thing."""
    kinds: dict[str, Callable[[Furnisher], None]] = {
        "ward": _ward,
        "exam": _exam,
        "waiting": _waiting,
        "reception": _reception,
        "nurses": _nurses,
        "staff": _staff,
        "consulting": _consulting,
        "store": _store,
        "wash": _wash,
        "hall": _hall,
    }
    furnishers = [Furnisher(plan, room, palette, clutter) for room in rooms]
    enter(furnishers, ("reception", "hall", "waiting"), plan.pick(39))
    for each in furnishers:
        kinds[each.room.kind](each)
        if each.room.kind in _SIGNED:
            _signs(each)
    complete(
        plan, furnishers, _EVERYWHERE, ("ward", "exam", "waiting", "reception", "nurses", "staff", "consulting", "hall")
    )
    for each in furnishers:
        each.hang_all()


def _signs(furnisher: Furnisher) -> None:
    """Mounts a lit sign above each door, on the outside of the room."""
    for side, centres in furnisher.room.doors.items():
        for centre in centres:
            out = WALL_THICKNESS_M
            x = {"W": furnisher.area.x0 - out, "E": furnisher.area.x1 + out}.get(side, centre)
            y = {"S": furnisher.area.y0 - out, "N": furnisher.area.y1 + out}.get(side, centre)
            furnisher.plan.add(furnisher.model("SM_Sign", 1), x, y, FACING[_OPPOSITE[side]], 0.06)


def _ward(furnisher: Furnisher) -> None:
    """Places beds with their heads at one or two walls, curtains between them, visitors' seats, basin and cabinet."""
    look = furnisher.plan.pick(6)
    sides = sorted(furnisher.sides(), key=lambda side: (side in furnisher.room.doors, side in furnisher.room.outside))
    beds = _bed_row(furnisher, sides[0], look)
    if beds < 2 or furnisher.rng.random() < 0.35:
        beds += _bed_row(furnisher, sides[1], look)
    if beds == 0:
        _beside_bed(furnisher, furnisher.wall_piece("SM_Bed", look, clearance=0.3, gap=_BED_GAP_M), look, 1.0)
    furnisher.wall_piece("SM_WashUnit", 0, clearance=0.3)
    furnisher.wall_piece("SM_Cabinet", furnisher.plan.pick(2), clearance=0.3)
    if furnisher.rng.random() < 0.45:
        furnisher.wall_piece("SM_Whiteboard_A", clearance=0.25)
    extra = ("SM_Stool_F", "SM_WheelChair", "SM_Trolley", "SM_ChairWood_D")[furnisher.plan.pick(4)]
    furnisher.small(("SM_TrashCan_A", extra, "SM_Plant_A"), 0.4)
    furnisher.hang(("SM_Television", "SM_PictureFrame")[furnisher.plan.pick(2)])
    furnisher.hang("SM_PictureFrame")
    furnisher.hang("SM_Poster")


def _bed_row(furnisher: Furnisher, side: str, look: int) -> int:
    """Places beds side by side with their heads at a wall, and returns their number."""
    rng, plan, count = furnisher.rng, furnisher.plan, 0
    pitch = float(rng.uniform(2.0, 2.5))
    places = max(1, int((furnisher.length(side) - 0.6) // pitch))
    bed = furnisher.model("SM_Bed", look)
    for place in range(places):
        along = (place + 0.5) * furnisher.length(side) / places
        x, y = furnisher.at_wall(side, along, float(bed.high[1]) + _BED_GAP_M)
        model = furnisher.model("SM_Bed", look + place)
        if plan.meets(model, x, y, FACING[side]):
            continue
        placed = plan.place(model, x, y, FACING[side], furnisher.area, 0.35)
        if placed is None:
            continue
        _beside_bed(furnisher, placed, look, 1.0 if place % 2 else -1.0)
        if count and rng.random() < 0.7:
            between = furnisher.at_wall(side, along - furnisher.length(side) / places / 2, 0.36)
            plan.place(furnisher.model("SM_Curtain", look), *between, FACING[side], furnisher.area, 0.0)
        count += 1
    return count


def _beside_bed(furnisher: Furnisher, bed: PropPlacement | None, look: int, turn: float) -> None:
    """Adds a service panel above a bed, a night stand, and in some cases an infusion stand and a visitor's chair."""
    if bed is None:
        return
    plan, rng = furnisher.plan, furnisher.rng
    c, s, back = math.cos(bed.yaw), math.sin(bed.yaw), float(bed.model.high[1]) + _BED_GAP_M
    wall_x, wall_y = bed.x - s * (back - 0.065), bed.y + c * (back - 0.065)
    plan.hang_at(furnisher.model("SM_HeadPanel", 0), wall_x, wall_y, bed.yaw)
    furnisher.beside("SM_Nightstand", look, bed, turn * 0.78, 0.0)
    if rng.random() < 0.6:
        furnisher.beside("SM_DripStand", 0, bed, -turn * 0.74, 0.0)
    if rng.random() < 0.75:
        shift, reach = turn * float(rng.uniform(0.95, 1.1)), float(rng.uniform(0.2, 0.9))
        x, y = bed.x + c * shift + s * reach, bed.y + s * shift - c * reach
        yaw = bed.yaw - turn * math.pi / 2 + float(rng.uniform(-0.3, 0.3))
        kind = (*_SEATS, "SM_ChairWood_D")[plan.pick(3)]
        plan.place(furnisher.model(kind), x, y, yaw, furnisher.area, 0.04)


def _exam(furnisher: Furnisher) -> None:
    """Places a couch, a desk with a screen, a trolley, a basin, cabinets, stools and a board."""
    plan = furnisher.plan
    bed = furnisher.wall_piece("SM_Bed", plan.pick(6), clearance=0.4, gap=0.15)
    if bed is not None and furnisher.rng.random() < 0.5:
        furnisher.beside("SM_DripStand", 0, bed, 0.74, 0.0)
    desk = furnisher.wall_piece("SM_TableDesk_A", furnisher.palette.wood, clearance=0.4, gap=0.06)
    workplace(furnisher, desk, plan.pick(5))
    furnisher.wall_piece("SM_WashUnit", 0, clearance=0.25)
    furnisher.wall_piece("SM_Cabinet", plan.pick(2), clearance=0.25)
    furnisher.wall_piece("SM_Whiteboard_A", clearance=0.25)
    furnisher.small(("SM_Trolley", "SM_Stool_F", "SM_TrashCan_A", "SM_ChairVisitor_C", "SM_FireExtinguisher_02"), 0.4)
    furnisher.hang("SM_Poster", 2)
    furnisher.hang("SM_ClockWall")


def _waiting(furnisher: Furnisher) -> None:
    """Places seats in rows, along the walls or in groups, a television, plants, machines and things for children."""
    plan = furnisher.plan
    kind, look = _SEATS[plan.pick(2)], plan.pick(5)
    has_rows = furnisher.rng.random() < 0.65
    (_seats_in_rows if has_rows else _seats_at_walls)(furnisher, kind, look)
    if furnisher.rng.random() < 0.5:
        seat_group(furnisher, rug=plan.pick(3))
    if furnisher.rng.random() < 0.5:
        furnisher.wall_piece("SM_VendingMachine", clearance=0.3)
    for share in () if has_rows else (0.3, 0.7):
        x, y = furnisher.area.x0 + share * furnisher.area.width, furnisher.area.y0 + share * furnisher.area.depth
        round_table(furnisher, (x, y), kind, look)
    furnisher.wall_piece("SM_Whiteboard_A", clearance=0.3)
    furnisher.corner("SM_Plant_A")
    furnisher.corner("SM_Plant_A")
    furnisher.small(
        ("SM_TrashCan_A", "SM_TrashCan_A", "SM_WaterDispenser", "SM_FireExtinguisher_02", "SM_ToyPile"), 0.45
    )
    furnisher.hang("SM_Television")
    furnisher.hang("SM_Poster", 2)
    furnisher.hang("SM_PictureFrame", 3)
    furnisher.hang("SM_ClockWall")


def _seats_in_rows(furnisher: Furnisher, kind: str, look: int) -> None:
    """Places double rows of seats back to back in the middle, with aisles of at least 1.6 m."""
    plan, area = furnisher.plan, furnisher.area
    is_along_x = area.width >= area.depth
    length, across = (area.width, area.depth) if is_along_x else (area.depth, area.width)
    seats = max(2, int((length - 3.2) // _SEAT_PITCH_M))
    rows = max(1, int((across - 1.6) // 3.0))
    for row in range(rows):
        for seat in range(seats):
            for side, yaw in ((-1, 0.0), (1, math.pi)):
                if furnisher.rng.random() < 0.1 or (seats > 6 and seat == seats // 2):
                    continue
                u = length / 2 + (seat - (seats - 1) / 2) * _SEAT_PITCH_M
                v = (row + 0.5) * across / rows + side * 0.34
                x, y = (area.x0 + u, area.y0 + v) if is_along_x else (area.x0 + v, area.y0 + u)
                variant = look if furnisher.rng.random() < 0.85 else look + 1
                plan.place(furnisher.model(kind, variant), x, y, yaw if is_along_x else -yaw - math.pi / 2, area, 0.0)


def _seats_at_walls(furnisher: Furnisher, kind: str, look: int) -> None:
    """Places rows of seats along the walls around an open floor."""
    for side in furnisher.sides()[:3]:
        count = max(2, int(furnisher.length(side) * 0.55 // _SEAT_PITCH_M))
        model = furnisher.model(kind, look)
        for seat in range(count):
            if furnisher.rng.random() < 0.88:
                along = furnisher.length(side) / 2 + (seat - (count - 1) / 2) * _SEAT_PITCH_M
                x, y = furnisher.at_wall(side, along, float(model.high[1]) + 0.1)
                furnisher.plan.place(
                    furnisher.model(kind, look if furnisher.rng.random() < 0.8 else look + 1),
                    x,
                    y,
                    FACING[side],
                    furnisher.area,
                    0.0,
                )


def _reception(furnisher: Furnisher) -> None:
    """Places one or two counters, stools and cabinets behind them, and seats in front of them."""
    plan, side = furnisher.plan, furnisher.sides()[0]
    shares = (0.28, 0.72) if furnisher.length(side) > 7.4 else (0.5,)
    variant = plan.pick(3)
    for share in shares:
        x, y = furnisher.at_wall(side, share * furnisher.length(side), 1.75)
        placed = plan.place(furnisher.model("SM_Reception", variant), x, y, FACING[side], furnisher.area, 0.3)
        if placed is not None:
            furnisher.before("SM_ChairOffice_A", None, of=placed, reach=-0.75, along=0.2, turn=math.pi)
            furnisher.on_top("SM_Monitor_A", None, below=placed, height=0.74, along=-0.4, back=0.05, turn=math.pi)
    for _ in range(2):
        furnisher.wall_piece("SM_Cabinet", plan.pick(3), side, 0.02)
    kind, look = _SEATS[plan.pick(2)], plan.pick(5)
    for _ in range(3 + plan.pick(3)):
        furnisher.wall_piece(kind, look, sides=None, clearance=0.06, gap=0.1)
    furnisher.corner("SM_Plant_A")
    furnisher.small(
        ("SM_TrashCan_A", "SM_FireExtinguisher_02", "SM_WaterDispenser", "SM_WheelChair", "SM_Plant_A"), 0.45
    )
    furnisher.hang("SM_ClockWall")
    furnisher.hang("SM_Poster", 2)


def _nurses(furnisher: Furnisher) -> None:
    """Places desks with screens along the walls, a board, trolleys and cabinets."""
    for _ in range(2 + furnisher.plan.pick(2)):
        desk = furnisher.wall_piece("SM_TableDesk_A", furnisher.palette.wood, clearance=0.4, gap=0.06)
        workplace(furnisher, desk, furnisher.palette.cover, is_second=True)
    furnisher.wall_piece("SM_Whiteboard_A", clearance=0.25)
    furnisher.wall_piece("SM_Cabinet", furnisher.plan.pick(3), clearance=0.2)
    furnisher.small(("SM_Trolley", "SM_TrashCan_A", "SM_Trolley", "SM_Plant_A", "SM_FireExtinguisher_02"), 0.35)
    furnisher.hang("SM_ClockWall")
    furnisher.hang("SM_PinBoard")


def _staff(furnisher: Furnisher) -> None:
    """Places a row of kitchen units, a round table, a sofa and lockers."""
    units, machines = ("SM_SinkUnit", "SM_KitchenUnit", "SM_KitchenUnit"), ("SM_CoffeeMachine", "SM_Microwave")
    kitchen_row(furnisher, furnisher.sides(), look=furnisher.palette.wood, names=units, tops=machines)
    furnisher.wall_piece("SM_Locker", furnisher.palette.cover, clearance=0.2)
    table = round_table(furnisher, furnisher.area.centre, "SM_ChairWood_D", furnisher.palette.wood)
    furnisher.dress(table, ("SM_Crockery", "SM_FruitBowl", "SM_Papers"), 1, 0.74)
    furnisher.wall_piece("SM_Sofa_A", furnisher.palette.cover, clearance=0.4, gap=0.05)
    furnisher.small(("SM_TrashCan_A", "SM_Plant_A", "SM_CoatStand", "SM_Backpack"), 0.35)
    furnisher.hang("SM_PinBoard")
    furnisher.hang("SM_PictureFrame", 2)


def _consulting(furnisher: Furnisher) -> None:
    """Places a doctor's desk with seats for visitors, a couch and shelves."""
    desk = furnisher.wall_piece("SM_TableDesk_A", furnisher.palette.wood, clearance=0.5, gap=0.06)
    workplace(furnisher, desk, furnisher.palette.cover)
    furnisher.small(("SM_ChairVisitor_C", "SM_ChairVisitor_C", "SM_TrashCan_A", "SM_Plant_A", "SM_Stool_F"), 0.35)
    furnisher.wall_piece("SM_ShelfBook_B", furnisher.palette.wood, clearance=0.25)
    furnisher.wall_piece("SM_WashUnit", 0, clearance=0.2)
    furnisher.dress(
        furnisher.wall_piece("SM_Sideboard", furnisher.palette.wood, clearance=0.3),
        ("SM_BookRow", "SM_Papers", "SM_Flasks"),
    )
    furnisher.hang("SM_PictureFrame", 2)
    furnisher.hang("SM_Poster")


def _store(furnisher: Furnisher) -> None:
    """Places steel shelves, cartons, wheelchairs and stands."""
    for number in range(2 + furnisher.plan.pick(2)):
        furnisher.wall_piece("SM_ShelfSteel_A", number, clearance=0.12)
    furnisher.small(("SM_WheelChair", "SM_CartonSingle", "SM_Trolley", "SM_CartonSingle", "SM_DripStand"), 0.25)


def _wash(furnisher: Furnisher) -> None:
    """Places toilets, basins and bins."""
    for _ in range(2):
        furnisher.wall_piece("SM_Toilet", clearance=0.3, gap=0.0)
        furnisher.wall_piece("SM_WashBasin", furnisher.palette.cover, clearance=0.25, gap=0.0)
    furnisher.small(("SM_TrashCan_A", "SM_TrashCan_A"), 0.3)


def _hall(furnisher: Furnisher) -> None:
    """Places extinguishers, bins, seats, trolleys and wheelchairs along the walls, and mounts notices and pictures."""
    plan = furnisher.plan
    kind, look = _SEATS[plan.pick(2)], plan.pick(5)
    for _ in range(plan.pick(4)):
        furnisher.wall_piece(kind, look, sides=None, clearance=0.06, gap=0.1)
    names = ["SM_FireExtinguisher_02", "SM_TrashCan_A", "SM_WheelChair", "SM_Trolley", "SM_Bench", "SM_WaterDispenser"]
    if max(furnisher.area.width, furnisher.area.depth) > 9.0:
        names += ["SM_FireExtinguisher_02", "SM_TrashCan_A", "SM_Plant_A"]
    furnisher.small(names, 0.55)
    furnisher.hang("SM_ClockWall")
    furnisher.hang("SM_Poster", 2)
    furnisher.hang("SM_PictureFrame", 2)
    furnisher.hang("SM_PinBoard")


_CEILINGS = ("tiles", "tiles", "tiles", "panels", "plain")
_OPEN = {
    frozenset(("waiting", HALL)): (2.0, 3.4),
    frozenset(("reception", HALL)): (1.8, 3.0),
    frozenset(("nurses", HALL)): (1.5, 2.4),
    frozenset(("waiting", "reception")): (2.0, 3.6),
}
_DADOS = ("#7fa894", "#7399ae", "#b59d6d", "#8f8fb0", "#b08a8a", "#7d9a6a", "#9aa3a8")
_LINES = ("Blue", "Green", "Red", "Yellow", "Purple", "Orange")


def lay_out_hospital(plan: FloorPlan) -> None:
    """Builds the rooms of one floor, then furnishes them.

    Raises:
        WorldError: no division of the floor into the chosen rooms was found; another seed may have one.
    """
    palette, rng = draw_palette(plan.rng, CLINIC), plan.rng
    ceiling, height = _CEILINGS[plan.pick(len(_CEILINGS))], float(rng.choice((2.7, 2.8, 3.0)))
    building = BuildingLook(
        _looks(palette, plan), _trim(plan), leaf=palette.leaf, ceiling=ceiling, views=palette.views, height=height
    )
    rooms = build_rooms(plan, _divide(plan), building)
    if rng.random() < 0.6:
        _guide_lines(plan, rooms)
    furnish_hospital(plan, rooms, palette, float(rng.uniform(0.55, 1.0)))


def _divide(plan: FloorPlan) -> Division:
    """Chooses the rooms, the halls and the outline at random."""
    rng = plan.rng
    specs, hall = _program(plan), float(rng.uniform(2.2, 3.0))
    area, ratio = sum(spec.area_m2 for spec in specs), float(rng.uniform(1.0, 1.7))
    width = (area * ratio) ** 0.5
    schemes = (spine_hall, t_hall, l_hall, l_hall, ring_hall, ring_hall)
    doors = Doors(float(rng.uniform(1.25, 1.45)), _OPEN, float(rng.uniform(0.2, 0.8)))
    scheme = schemes[plan.pick(len(schemes))](hall)
    return turned(
        rng, divide_floor(rng, Rectangle(0.0, 0.0, width, area / width), specs=specs, doors=doors, scheme=scheme)
    )


def _program(plan: FloorPlan) -> list[RoomSpec]:
    """Chooses at random the rooms of a floor with more wards or more treatment rooms."""
    rng = plan.rng
    wards, exams = ((4, 1), (3, 2), (2, 3), (5, 1), (3, 1))[plan.pick(5)]

    def room(kind: str, low: float, high: float, least: float, is_hub: bool = False) -> RoomSpec:
        return RoomSpec(kind, float(rng.uniform(low, high)), least, is_hub)

    specs = [room("ward", 24, 40, 4.3) for _ in range(wards)]
    specs += [room("exam", 15, 22, 3.4) for _ in range(exams)]
    specs += [room("waiting", 34, 62, 4.8, True), room("wash", 10, 14, 2.7)]
    for kind, low, high, least, is_hub, share in (
        ("reception", 24, 36, 4.3, True, 0.65),
        ("nurses", 14, 22, 3.3, True, 0.7),
        ("staff", 17, 25, 3.4, False, 0.5),
        ("store", 10, 15, 2.7, False, 0.6),
        ("consulting", 13, 18, 3.2, False, 0.6),
    ):
        if rng.random() < share:
            specs.append(room(kind, low, high, least, is_hub))
    return specs


def _trim(plan: FloorPlan) -> Trim:
    """Chooses the trim of the walls at random: most hospitals have a darker dado, and many of these a bumper rail."""
    skirting = (painted("Charcoal", 0.5), painted("Grey", 0.5), painted("White", 0.45))[plan.pick(3)]
    frame = (wood("Oak"), wood("Pale"), painted("LightGrey", 0.5), painted("SkyBlue", 0.5), painted("White", 0.45))
    if plan.rng.random() < 0.25:
        return Trim(skirting=skirting, frame=frame[plan.pick(5)])
    tint = _DADOS[plan.pick(len(_DADOS))]
    rail = (wood("Pale"), wood("Oak"), painted("LightGrey", 0.5), None)[plan.pick(4)]
    dado = tinted("Plaster", f"DadoPlaster{tint[1:]}", colour=tint, tile_m=1.0, roughness=0.6)
    return Trim(rail, dado, float(plan.rng.choice((0.8, 1.0, 1.2))), skirting, frame=frame[plan.pick(5)])


def _looks(palette: Palette, plan: FloorPlan) -> dict[str, RoomLook]:
    paints = palette.paints
    window, pitch = (("SM_WindowHome", 2.6), ("SM_WindowBand", 3.1))[plan.pick(2)]
    dry = (palette.stone, palette.pile)[plan.pick(2)]

    def look(floor: SurfaceMaterial, number: int, windows: int) -> RoomLook:
        return RoomLook(floor, paints[number], windows=windows, curtain=None, window=window, window_pitch_m=pitch)

    return {
        "ward": look(palette.pile, 0, 2),
        "exam": look(palette.pile, 1, 1),
        "waiting": look(dry, 2, 4),
        "reception": look(dry, 2, 2),
        "nurses": look(palette.pile, 3, 1),
        "staff": look(palette.boards, 4, 2),
        "consulting": look(palette.boards, 4, 1),
        "store": look(palette.stone, 5, 0),
        "wash": RoomLook(palette.stone, palette.tiles, 0),
        HALL: RoomLook(palette.pile, paints[3], windows=4, curtain=None, window=window, window_pitch_m=max(pitch, 3.2)),
    }


def _guide_lines(plan: FloorPlan, rooms: list[BuiltRoom]) -> None:
    """Paints two coloured lines along the middle of each part of the hall."""
    first = plan.pick(len(_LINES))
    for room in rooms:
        if room.kind != HALL:
            continue
        (x, y), is_along_x = room.area.centre, room.area.width >= room.area.depth
        for number, shift in enumerate((-0.09, 0.09)):
            line = room.area._replace(y0=y + shift - 0.05, y1=y + shift + 0.05)
            if not is_along_x:
                line = room.area._replace(x0=x + shift - 0.05, x1=x + shift + 0.05)
            marking(plan, line, painted(_LINES[(first + number) % len(_LINES)], 0.6))
