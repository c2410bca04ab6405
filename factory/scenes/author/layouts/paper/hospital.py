"""Layout of the hospital: 30 x 20 m, a corridor, a waiting hall opposite a reception, wards with beds on both sides.

Places structures and props, in metres. Does not build meshes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from factory.scenes.author.layouts.paper.building import PLASTER, Cell, Room, Style, build_wings, divide
from factory.scenes.author.materials import SurfaceMaterial, painted, textured, tinted
from factory.scenes.author.placement import FACING, FloorPlan, Rectangle
from factory.scenes.author.room import Trim, marking

SIZE = (30.0, 20.0)
LINOLEUM = textured("Linoleum", "#a3b3b2", 1.5, 0.3)
WARM = textured("LinoleumWarm", "#bba98c", 1.5, 0.3)
TILES = textured("TileFloor", "#c9c6bd", 1.6, 0.3)
RAIL = textured("WoodPale", "#d9c19a", 0.8, 0.4)


class Paint(NamedTuple):
    """Wall paint with its trim: a rail over a darker dado."""

    wall: SurfaceMaterial
    trim: Trim


MINT, SKY, CREAM = (
    Paint(
        tinted("Plaster", f"Wall{name}", colour=wall, tile_m=0.8, roughness=0.85),
        Trim(RAIL, SurfaceMaterial(f"Dado{name}", dado, roughness=0.6)),
    )
    for name, wall, dado in (
        ("Mint", "#b5cdbf", "#7fa894"),
        ("Sky", "#b3cad6", "#7399ae"),
        ("Cream", "#dccfb0", "#b59d6d"),
    )
)


def lay_out_hospital(plan: FloorPlan) -> None:
    """Builds the structures, then furnishes corridor, halls and wards."""
    rng = plan.rng
    width, middle = float(rng.uniform(2.6, 3.0)), SIZE[1] / 2 + float(rng.uniform(-0.4, 0.4))
    corridor = (middle - width / 2, middle + width / 2)
    wings = {side: divide(rng, _cells(plan, hall), SIZE[0]) for side, hall in (("S", "waiting"), ("N", "reception"))}
    ward_paints = [(MINT, SKY, CREAM)[k] for k in rng.permutation(3)]
    styles = {
        "corridor": Style(LINOLEUM, ward_paints[2].wall, trim=ward_paints[2].trim),
        "ward": Style(LINOLEUM, ward_paints[0].wall, has_windows=False, trim=ward_paints[0].trim),
        "exam": Style(WARM, ward_paints[1].wall),
        "waiting": Style(TILES, PLASTER),
        "reception": Style(TILES, ward_paints[1].wall, has_windows=False),
    }
    rooms = build_wings(plan, SIZE, corridor=corridor, wings=wings, styles=styles)
    _guide_lines(plan, corridor)
    furnish = {"ward": _ward, "exam": _exam, "waiting": _waiting, "reception": _reception}
    for room in rooms:
        furnish[room.kind](plan, room)
    _corridor(plan, Rectangle(0.12, corridor[0] + 0.12, SIZE[0] - 0.12, corridor[1] - 0.12))
    plan.top_up("SM_FireExtinguisher_02", 6, [room.area for room in rooms])
    plan.top_up("SM_Whiteboard_A", 6, [room.area for room in rooms])


def _guide_lines(plan: FloorPlan, corridor: tuple[float, float]) -> None:
    """Adds two coloured guide lines along the corridor floor."""
    first, second = (("Blue", "Green"), ("Red", "Blue"), ("Green", "Orange"))[plan.pick(3)]
    middle = (corridor[0] + corridor[1]) / 2
    for paint, shift in ((first, -0.09), (second, 0.09)):
        y = middle + shift
        marking(plan, Rectangle(0.3, y - 0.05, SIZE[0] - 0.3, y + 0.05), painted(paint, 0.5))


def _cells(plan: FloorPlan, hall: str) -> list[Cell]:
    """Returns three wards and an examination room in random order around the hall."""
    rooms = [Cell("ward", 5.0, float(plan.rng.uniform(1.25, 1.5))) for _ in range(3)]
    rooms.append(Cell("exam", 4.6, float(plan.rng.uniform(1.2, 1.4))))
    order = [rooms[k] for k in plan.rng.permutation(len(rooms))]
    order.insert(1 + plan.pick(3), Cell(hall, 7.6, 2.4))
    return order


def _ward(plan: FloorPlan, room: Room) -> None:
    """Places beds with their heads at the outer wall, one bed at a side wall, a wash basin, a bin and a board."""
    area, rng, props = room.area, plan.rng, plan.props
    look = plan.pick(6)
    y_head, inward = _head_wall(room)
    for bed in (0, 1):
        _bed_place(plan, room, bed, look)
    if rng.random() < 0.8:
        plan.place(props.model("SM_Curtain", look), area.centre[0], y_head + inward * 0.32, 0.0, area, 0.0)
    plan.add(props.model("SM_Window", 1), area.centre[0], y_head, FACING[room.outer])
    bed_side, board_side = ("E", "W") if rng.random() < 0.5 else ("W", "E")
    _side_bed(plan, room, bed_side, look)
    if rng.random() < 0.6:
        along = 0.25 if room.outer == "N" else 0.75
        plan.against(props.model("SM_Whiteboard_A", plan.pick(2)), area, board_side, along)
    plan.against_somewhere(props.model("SM_WashUnit", 0), area, "EW", 0.4)
    extra = ("SM_ChairWaiting_E", "SM_Stool_F", "SM_WheelChair", "SM_Trolley")[plan.pick(4)]
    _along(plan, room, ("SM_TrashCan_A", "SM_Cabinet", extra))
    _decorate(plan, room)


def _head_wall(room: Room) -> tuple[float, float]:
    """Returns the y of the face of the outer wall and the sign of the direction into the room."""
    return (room.area.y1, -1.0) if room.outer == "N" else (room.area.y0, 1.0)


def _bed_place(plan: FloorPlan, room: Room, bed: int, look: int) -> None:
    """Places a bed at the outer wall with a service panel, a night stand, a visitor's chair on the inner side and
    sometimes an infusion stand."""
    area, rng, props = room.area, plan.rng, plan.props
    y_head, inward = _head_wall(room)
    yaw, outside = FACING[room.outer], -1.0 if bed == 0 else 1.0
    x = area.x0 + (0.24, 0.76)[bed] * area.width
    if not plan.place(props.model("SM_Bed", look + bed), x, y_head + inward * 1.12, yaw, area, 0.1):
        return
    plan.add(props.model("SM_HeadPanel", 0), x, y_head + inward * 0.065, yaw)
    plan.place(props.model("SM_Nightstand", look), x - outside * 0.78, y_head + inward * 0.3, yaw, area, 0.0)
    if rng.random() < 0.7:
        plan.place(props.model("SM_DripStand", 0), x + outside * 0.72, y_head + inward * 0.6, 0.0, area, 0.0)
    kind = ("SM_ChairWaiting_E", "SM_ChairVisitor_C", "SM_ChairWood_D")[plan.pick(3)]
    turn = yaw - outside * inward * math.pi / 2 + float(rng.uniform(-0.3, 0.3))
    y = y_head + inward * float(rng.uniform(1.5, 1.9))
    plan.place(props.model(kind, plan.pick(5)), x - outside * 0.95, y, turn, area, 0.05)


def _side_bed(plan: FloorPlan, room: Room, side: str, look: int) -> None:
    """Places a third bed with its head at a side wall, with its panel and night stand."""
    area, props = room.area, plan.props
    share = float(plan.rng.uniform(0.50, 0.54))
    bed = plan.against(
        props.model("SM_Bed", look + 2),
        area,
        side=side,
        along=share if room.outer == "N" else 1 - share,
        clearance=0.2,
        gap=0.1,
    )
    if bed is None:
        return
    into = -1.0 if side == "E" else 1.0
    wall_x = area.x1 if side == "E" else area.x0
    plan.add(props.model("SM_HeadPanel", 0), wall_x + into * 0.065, bed.y, FACING[side])
    _, inward = _head_wall(room)
    plan.place(props.model("SM_Nightstand", look), wall_x + into * 0.3, bed.y + inward * 0.8, FACING[side], area, 0.0)


def _exam(plan: FloorPlan, room: Room) -> None:
    """Places one bed, a trolley, a cabinet, stools and a board."""
    area, rng, props = room.area, plan.rng, plan.props
    side = "EW"[plan.pick(2)]
    along = 0.72 if room.outer == "N" else 0.28
    plan.against(props.model("SM_Bed", plan.pick(6)), area, side=side, along=along, clearance=0.1, gap=0.15)
    other = "W" if side == "E" else "E"
    plan.against(
        props.model("SM_Whiteboard_A", plan.pick(3)),
        area,
        side=other,
        along=float(rng.uniform(0.35, 0.65)),
        clearance=0.2,
    )
    plan.against_somewhere(props.model("SM_Trolley", plan.pick(3)), area, room.outer, 0.2)
    plan.against_somewhere(props.model("SM_WashUnit", 0), area, room.outer, 0.2)
    for name in (
        "SM_Stool_F",
        "SM_ChairVisitor_C",
        "SM_ChairWaiting_E",
        "SM_TrashCan_A",
        "SM_Cabinet",
        "SM_FireExtinguisher_02",
    ):
        _along(plan, room, (name,))
    _decorate(plan, room)


def _waiting(plan: FloorPlan, room: Room) -> None:
    """Places rows of chairs along three walls around an open floor, a board, a television and bins."""
    area, rng, props = room.area, plan.rng, plan.props
    marking(plan, area.grown(-1.6), WARM)
    look, kind = plan.pick(5), ("SM_ChairWaiting_E", "SM_ChairVisitor_C")[plan.pick(2)]
    for side, seats in ((room.outer, 6), ("E", 4), ("W", 4)):
        pitch = 0.68 / (area.width if side in "NS" else area.depth)
        start = 0.5 - pitch * (seats - 1) / 2
        for seat in range(seats):
            if rng.random() < 0.85:
                model = props.model(kind, look if rng.random() < 0.8 else look + 1)
                plan.against(model, area, side=side, along=start + seat * pitch, clearance=0.0, gap=0.1)
    plan.hang(props.model("SM_Television", 1), area, "EW"[plan.pick(2)], 0.5)
    _along(plan, room, ("SM_TrashCan_A", "SM_TrashCan_A", "SM_WaterCooler", "SM_FireExtinguisher_02"))
    plan.against_somewhere(props.model("SM_Whiteboard_A", 1), area, "EW", 0.2)
    _decorate(plan, room)


def _reception(plan: FloorPlan, room: Room) -> None:
    """Places a reception counter in front of the outer wall, cabinets behind it and waiting chairs on the sides."""
    area, rng, props = room.area, plan.rng, plan.props
    y_wall, inward = _head_wall(room)
    plan.place(
        props.model("SM_Reception", plan.pick(3)),
        area.centre[0],
        y_wall + inward * 2.3,
        FACING[room.outer],
        area,
        0.1,
    )
    for along in (0.3, 0.5, 0.7):
        plan.against(props.model("SM_Cabinet", plan.pick(3)), area, side=room.outer, along=along, clearance=0.02)
    stool_y = y_wall + inward * 1.45
    plan.place(props.model("SM_Stool_F", 0), area.centre[0] + float(rng.uniform(-0.6, 0.6)), stool_y, 0.0, area, 0.2)
    look, low = plan.pick(5), 0.12 if room.outer == "N" else 0.55
    for seat in range(3):
        for side in "EW":
            plan.against(
                props.model("SM_ChairVisitor_C", look),
                area,
                side=side,
                along=low + 0.14 * seat,
                clearance=0.02,
                gap=0.08,
            )
    _along(plan, room, ("SM_TrashCan_A", "SM_FireExtinguisher_02"))
    plan.hang(props.model("SM_Clock", 0), area, room.outer, 0.5)
    _decorate(plan, room)


def _corridor(plan: FloorPlan, area: Rectangle) -> None:
    """Places bins, extinguishers, chairs, a trolley and a wheelchair along the corridor walls."""
    props = plan.props
    names = ["SM_FireExtinguisher_02", "SM_TrashCan_A", "SM_ChairWaiting_E"] * 3
    names += ["SM_WheelChair", "SM_Trolley", "SM_ChairVisitor_C", "SM_TrashCan_A"]
    for number, name in enumerate(names):
        model = props.model(name, plan.pick(12))
        plan.against_somewhere(model, area, "NS"[number % 2], 0.5)
    plan.against(props.model("SM_Whiteboard_A", 1), area, "EW"[plan.pick(2)], 0.5)
    plan.hang(props.model("SM_Clock", 0), area, "EW"[plan.pick(2)], 0.2)


def _along(plan: FloorPlan, room: Room, names: tuple[str, ...]) -> None:
    """Places small props along the walls where they fit."""
    for name in names:
        variant = plan.pick(2) if name == "SM_Cabinet" else plan.pick(12)  # excludes variant 2, a bookcase
        plan.against_somewhere(plan.props.model(name, variant), room.area, "EW" + room.inner, 0.5)


def _decorate(plan: FloorPlan, room: Room) -> None:
    """Mounts a notice on a side wall, and a lit sign above the door on both sides of the corridor wall."""
    props = plan.props
    plan.hang(
        props.model("SM_Poster", plan.pick(3) + 3 * (len(plan.placements) % 3)),
        room.area,
        "EW"[plan.pick(2)],
        float(plan.rng.uniform(0.1, 0.9)),
    )
    inner = room.area.y1 if room.inner == "N" else room.area.y0
    outward = 1.0 if room.inner == "N" else -1.0
    plan.add(props.model("SM_Sign", 0), room.door.centre, inner, FACING[room.inner], 0.06)
    plan.add(props.model("SM_Sign", 1), room.door.centre, inner + outward * 0.12, FACING[room.outer], 0.06)
