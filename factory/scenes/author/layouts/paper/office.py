"""Layout of the office: 24 x 16 m, rooms along a corridor: open plan, meeting, private, lounge, kitchen.

Places structures and props, in metres; monitors on desks stay reachable. Does not build meshes.
"""

from __future__ import annotations

import math

from factory.scenes.author.layouts.paper.building import PLASTER, Cell, Room, Style, build_wings, divide
from factory.scenes.author.materials import painted, textured, tinted
from factory.scenes.author.placement import FACING, FloorPlan, Rectangle, wall_pose
from factory.scenes.author.room import Trim, marking

SIZE = (24.0, 16.0)
CARPET = textured("Carpet", "#6a7078", 1.0, 0.95)
CARPET_HALL = textured("CarpetCorridor", "#8b8a86", 1.0, 0.95)
PLANKS = textured("FloorPlanks", "#b08a5c", 1.2, 0.5)
TILES = textured("TileFloor", "#c9c6bd", 1.6, 0.4)
FABRIC_RED = textured("FabricRed", "#a32a26", 0.4, 0.95)
FABRIC_BLUE = textured("FabricBlue", "#2f5597", 0.4, 0.95)
FABRIC_GREEN = textured("FabricGreen", "#3f7d4a", 0.4, 0.95)
PAINTS = (
    tinted("Plaster", "WallHarbour", colour="#6f8fa3", tile_m=0.8, roughness=0.9),
    tinted("Plaster", "WallSage", colour="#a9b79a", tile_m=0.8, roughness=0.9),
    tinted("Plaster", "WallSand", colour="#d3c09c", tile_m=0.8, roughness=0.9),
    tinted("Plaster", "WallRose", colour="#c79c8b", tile_m=0.8, roughness=0.9),
)
LIGHT_TRIM = Trim(skirting=painted("White", 0.45))
SOUTH = (Cell("open", 8.4, 2.2), Cell("meeting", 5.4, 1.5), Cell("private", 4.6, 1.25), Cell("kitchen", 5.0, 1.6))
NORTH = (Cell("lounge", 5.6, 1.9), Cell("open", 8.4, 2.2), Cell("private", 4.6, 1.25), Cell("meeting", 5.4, 1.5))


def lay_out_office(plan: FloorPlan) -> None:
    """Builds the structures, then furnishes corridor and rooms."""
    rng = plan.rng
    middle, width = SIZE[1] / 2 + float(rng.uniform(-0.4, 0.4)), float(rng.uniform(2.2, 2.7))
    corridor = (middle - width / 2, middle + width / 2)
    wings = {
        side: divide(rng, [cells[k] for k in rng.permutation(len(cells))], SIZE[0])
        for side, cells in (("S", SOUTH), ("N", NORTH))
    }
    accents = [PAINTS[k] for k in rng.permutation(len(PAINTS))]
    styles = {
        "corridor": Style(CARPET_HALL, PLASTER),
        "open": Style(CARPET, PLASTER),
        "meeting": Style(CARPET, accents[0], trim=LIGHT_TRIM),
        "private": Style(CARPET, accents[1], trim=LIGHT_TRIM),
        "lounge": Style(PLANKS, accents[2], trim=LIGHT_TRIM),
        "kitchen": Style(TILES, accents[3], trim=LIGHT_TRIM),
    }
    rooms = build_wings(plan, SIZE, corridor=corridor, wings=wings, styles=styles)
    furnish = {
        "open": _open_plan,
        "meeting": _meeting,
        "private": _private,
        "lounge": _lounge,
        "kitchen": _kitchen,
    }
    for room in rooms:
        furnish[room.kind](plan, room)
    _corridor(plan, Rectangle(0.06, corridor[0] + 0.06, SIZE[0] - 0.06, corridor[1] - 0.06))
    seated = [room.area for room in rooms if room.kind in ("lounge", "private", "meeting")]
    plan.top_up("SM_Sofa_A", 4, seated)
    everywhere = [room.area for room in rooms]
    plan.top_up("SM_FireExtinguisher_02", 5, everywhere)
    plan.top_up("SM_Whiteboard_A", 4, everywhere)


def _workplace(plan: FloorPlan, x: float, y: float, yaw: float, look: int, room: Rectangle) -> None:
    """Places a desk with monitor, keyboard and a chair that is partly under the desk."""
    props, rng = plan.props, plan.rng
    desk = props.model("SM_TableDesk_A", look)
    if not plan.place(desk, x, y, yaw, room, 0.02):
        return
    c, s = math.cos(yaw), math.sin(yaw)
    aside = float(rng.uniform(-0.2, 0.2))

    def local(a: float, b: float) -> tuple[float, float]:
        return x + c * a - s * b, y + s * a + c * b

    top = 0.745
    plan.add(
        props.model("SM_Monitor_A", look + plan.pick(2)),
        *local(aside, 0.08),
        yaw + float(rng.uniform(-0.2, 0.2)),
        top,
    )
    plan.add(props.model("SM_TypingPad", 0), *local(aside, -0.2), yaw, top)
    chair = props.model(("SM_ChairOffice_A", "SM_ChairOffice_A", "SM_ChairExecutive_B")[plan.pick(3)], plan.pick(5))
    tuck = float(rng.uniform(-0.42, -0.34))
    plan.place(
        chair,
        *local(aside + float(rng.uniform(-0.1, 0.1)), tuck),
        yaw + math.pi + float(rng.uniform(-0.3, 0.3)),
        room,
        0.0,
        True,
    )


def _wall_workplace(plan: FloorPlan, area: Rectangle, side: str, along: float, look: int) -> None:
    """Places a workplace with the back of the desk to a wall."""
    desk = plan.props.model("SM_TableDesk_A", look)
    x, y, yaw = wall_pose(desk, area, side=side, along=along, gap=0.06)
    _workplace(plan, x, y=y, yaw=yaw, look=look, room=area)


def _open_plan(plan: FloorPlan, room: Room) -> None:
    """Places pairs of desks, single desks along the walls, boards, plants, bins and a copier around an open middle."""
    area, rng, props = room.area, plan.rng, plan.props
    look = plan.pick(12)
    marking(plan, Rectangle(*area.centre, *area.centre).grown(1.4), CARPET_HALL)
    spread = float(rng.uniform(0.0, 0.06))
    for along in ((0.10, 0.32, 0.88), (0.12, 0.68, 0.90), (0.10, 0.50, 0.90))[plan.pick(3)]:
        _wall_workplace(plan, area, side=room.outer, along=along + spread - 0.03, look=look)
    desk_side, board_side = ("E", "W") if rng.random() < 0.5 else ("W", "E")
    near = 0.34 if room.outer == "N" else 0.66
    _wall_workplace(plan, area, side=desk_side, along=near + float(rng.uniform(-0.06, 0.06)), look=look)
    if rng.random() < 0.5:
        _wall_workplace(plan, area, side=board_side, along=1.0 - near, look=look)
    plan.against(props.model("SM_Whiteboard_A", plan.pick(2)), area, side=board_side, along=near, clearance=0.2)
    for _ in range(2):
        plan.in_some_corner(props.model("SM_Plant_A", plan.pick(12)), area)
    _along(plan, room, ("SM_TrashCan_A", "SM_TrashCan_A", "SM_Printer", "SM_Cabinet", "SM_FireExtinguisher_02"))
    plan.hang(props.model("SM_Clock", 0), area, room.inner, float(rng.uniform(0.1, 0.9)))
    _decorate(plan, room, 2)


def _meeting(plan: FloorPlan, room: Room) -> None:
    """Places a conference table near the windows with chairs under its edge, and a board and a bin in the free half."""
    area, rng, props = room.area, plan.rng, plan.props
    inward = -1.0 if room.outer == "N" else 1.0
    x = area.centre[0] + float(rng.uniform(-0.2, 0.2))
    y = (area.y1 if room.outer == "N" else area.y0) + inward * float(rng.uniform(2.0, 2.2))
    table = props.model("SM_TableMeeting_B", plan.pick(4))
    if plan.place(table, x, y, 0.0, area, 0.6):
        look, kind = plan.pick(5), ("SM_ChairVisitor_C", "SM_ChairOffice_A")[plan.pick(2)]
        for shift in (-0.34, 0.34):
            turn, depth = float(rng.uniform(-0.12, 0.12)), 0.42 + float(rng.uniform(0.0, 0.06))
            yaw = FACING[room.inner] + turn
            plan.place(props.model(kind, look), x + shift, y + inward * depth, yaw, area, 0.0, True)
        end = 1.0 if rng.random() < 0.5 else -1.0
        plan.place(props.model(kind, look), x + end * 0.94, y, FACING["E" if end > 0 else "W"], area, 0.0, True)
    board, screen = ("E", "W") if rng.random() < 0.5 else ("W", "E")
    near = float(rng.uniform(0.3, 0.45))
    near = near if room.outer == "N" else 1.0 - near
    plan.against(props.model("SM_Whiteboard_A", plan.pick(3)), area, board, near)
    plan.hang(props.model("SM_Television", plan.pick(2)), area, screen, 0.5)
    plan.in_some_corner(props.model("SM_Plant_A", plan.pick(12)), area)
    _along(plan, room, ("SM_TrashCan_A",))
    _decorate(plan, room, 1)


def _private(plan: FloorPlan, room: Room) -> None:
    """Places a desk at a side wall, a sofa opposite, a visitor chair by the window, a plant and a book case."""
    area, rng, props = room.area, plan.rng, plan.props
    sofa_side, desk_side = ("E", "W") if rng.random() < 0.5 else ("W", "E")
    along = float(rng.uniform(0.55, 0.65))
    along = along if room.outer == "N" else 1.0 - along
    _wall_workplace(plan, area, side=desk_side, along=along, look=plan.pick(12))
    plan.against(props.model("SM_Sofa_A", plan.pick(6)), area, side=sofa_side, along=along, clearance=0.3)
    chair = props.model("SM_ChairVisitor_C", plan.pick(5))
    plan.against(chair, area, side=room.outer, along=float(rng.uniform(0.4, 0.6)), clearance=0.3, gap=0.08)
    plan.against_somewhere(props.model("SM_Cabinet", 2), area, "EW", 0.3)
    plan.in_some_corner(props.model("SM_Plant_A", plan.pick(12)), area)
    _along(plan, room, ("SM_TrashCan_A", "SM_CoatStand"))
    _decorate(plan, room, 1)


def _lounge(plan: FloorPlan, room: Room) -> None:
    """Places sofas along the walls, a low table that is not in line with them, plants and a lamp."""
    area, rng, props = room.area, plan.rng, plan.props
    x, y = area.centre
    look = plan.pick(6)
    rug = (FABRIC_RED, FABRIC_BLUE, FABRIC_GREEN)[plan.pick(3)]
    marking(plan, Rectangle(x - 1.1, y - 0.8, x + 1.1, y + 0.8), rug)
    for number, side in enumerate((room.outer, "E", "W")):
        plan.against(
            props.model("SM_Sofa_A", look + number),
            area,
            side=side,
            along=float(rng.uniform(0.4, 0.6)),
            clearance=0.5,
            gap=0.05,
        )
    corner_x = x + (1 if rng.random() < 0.5 else -1) * float(rng.uniform(1.0, 1.2))
    corner_y = y + (1.35 if room.outer == "N" else -1.35)
    plan.place(props.model("SM_TableCoffee_D", plan.pick(4)), corner_x, corner_y, 0.0, area, 0.2)
    plan.place(
        props.model("SM_TableRound_C", plan.pick(6)),
        x + float(rng.uniform(-0.3, 0.3)),
        y - (0.9 if room.outer == "N" else -0.9),
        0.0,
        area,
        0.5,
    )
    for _ in range(3):
        plan.in_some_corner(props.model("SM_Plant_A", plan.pick(12)), area)
    _along(plan, room, ("SM_TrashCan_A", "SM_FloorLamp", "SM_FireExtinguisher_02"))
    _decorate(plan, room, 2)


def _kitchen(plan: FloorPlan, room: Room) -> None:
    """Places a row of kitchen units on one wall, two round tables with a few chairs, bins and a fridge."""
    area, rng, props = room.area, plan.rng, plan.props
    run = "EW"[plan.pick(2)]
    plan.against(props.model("SM_KitchenCounter", plan.pick(3)), area, side=run, along=0.5, clearance=0.0, gap=0.0)
    plan.against(props.model("SM_Fridge", 0), area, side=run, along=0.99 if room.outer == "N" else 0.01, clearance=0.02)
    look, kind = plan.pick(5), ("SM_ChairWood_D", "SM_ChairWaiting_E")[plan.pick(2)]
    shift = 0.8 if run == "W" else -0.8
    for share in (0.3, 0.72):
        x, y = area.centre[0] + shift + float(rng.uniform(-0.2, 0.2)), area.y0 + share * area.depth
        if plan.place(props.model("SM_TableRound_C", look + plan.pick(2)), x, y, 0.0, area, 0.5):
            first = float(rng.uniform(0.0, 2 * math.pi))
            for turn in (0.0, 2 * math.pi / 3, 4 * math.pi / 3)[:2]:
                a = first + turn
                plan.place(
                    props.model(kind, look),
                    x + 0.5 * math.cos(a),
                    y + 0.5 * math.sin(a),
                    a - math.pi / 2,
                    area,
                    0.0,
                    True,
                )
    _along(plan, room, ("SM_TrashCan_A", "SM_TrashCan_A", "SM_FireExtinguisher_02", "SM_WaterCooler"))
    plan.in_some_corner(props.model("SM_Plant_A", plan.pick(12)), area)
    _decorate(plan, room, 1)


def _corridor(plan: FloorPlan, area: Rectangle) -> None:
    """Places extinguishers, bins, plants and pictures along a corridor whose middle stays free."""
    props = plan.props
    for number, name in enumerate(
        (
            "SM_FireExtinguisher_02",
            "SM_TrashCan_A",
            "SM_FireExtinguisher_02",
            "SM_WaterCooler",
            "SM_TrashCan_A",
        )
    ):
        plan.against_somewhere(props.model(name, plan.pick(12)), area, "NS"[number % 2], 0.6)
    plan.against(props.model("SM_Whiteboard_A", 1), area, "EW"[plan.pick(2)], 0.5)
    for corner in (plan.pick(2), 2 + plan.pick(2)):
        plan.in_corner(props.model("SM_Plant_A", plan.pick(12)), area, corner)


def _along(plan: FloorPlan, room: Room, names: tuple[str, ...]) -> None:
    """Places small props along the walls where they fit."""
    for name in names:
        plan.against_somewhere(plan.props.model(name, plan.pick(12)), room.area, "EW" + room.inner, 0.55)


def _decorate(plan: FloorPlan, room: Room, posters: int) -> None:
    """Mounts pictures on the side walls and an exit sign above the door."""
    props = plan.props
    for _ in range(posters):
        plan.hang(
            props.model("SM_Poster", plan.pick(3) + 3 * (len(plan.placements) % 3)),
            room.area,
            "EW"[plan.pick(2)],
            float(plan.rng.uniform(0.08, 0.92)),
        )
    sign = props.model("SM_Sign", 0)
    y = room.area.y1 if room.inner == "N" else room.area.y0
    plan.add(sign, room.door.centre, y, FACING[room.inner], 0.06)
