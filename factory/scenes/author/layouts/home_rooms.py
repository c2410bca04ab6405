"""Furnishes the rooms of a home: living and dining room, kitchen, bedrooms, bath, study, laundry and hall.

Places props in metres; larger ones first. Does not build walls.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from factory.scenes.author.dwelling import Chamber, rug
from factory.scenes.author.placement import FACING, FloorPlan, PropPlacement, Rectangle, wall_pose
from factory.scenes.author.style import Palette

_OPPOSITE = {"N": "S", "S": "N", "E": "W", "W": "E"}


class Furnisher:
    """Places furniture of one style in one room."""

    def __init__(self, plan: FloorPlan, room: Chamber, palette: Palette) -> None:
        self.plan, self.room, self.area, self.palette = plan, room, room.area, palette
        self.rng = plan.rng

    def length(self, side: str) -> float:
        """Returns the length of a wall, metres."""
        return self.area.width if side in "NS" else self.area.depth

    def sides(self) -> str:
        """Returns the four sides in random order, those without an opening first."""
        order = ["NESW"[k] for k in self.rng.permutation(4)]
        return "".join(sorted(order, key=lambda side: side in self.room.doors))

    def wall_piece(
        self, name: str, variant: int, sides: str | None = None, clearance: float = 0.1, gap: float = 0.02
    ) -> PropPlacement | None:
        """Places a piece with its back to the first wall with room, at a random position."""
        model = self.plan.props.model(name, variant)
        for side in sides or self.sides():
            for share in (float(self.rng.uniform(0.3, 0.7)), *self.rng.uniform(0.0, 1.0, 5).tolist(), 0.0, 1.0):
                found = self.plan.against(model, self.area, side, share, clearance, gap)
                if found is not None:
                    return found
        return None

    def on_top(self, name: str, variant: int, below: PropPlacement, height: float, along: float = 0.0) -> None:
        """Places a small thing on furniture, `along` metres off its centre."""
        c, s = math.cos(below.yaw), math.sin(below.yaw)
        self.plan.add(self.plan.props.model(name, variant), below.x + c * along, below.y + s * along, below.yaw, height)

    def beside(self, name: str, variant: int, of: PropPlacement, along: float, gap: float) -> PropPlacement | None:
        """Places a piece at the same wall, `along` metres from the centre of another one."""
        model = self.plan.props.model(name, variant)
        c, s = math.cos(of.yaw), math.sin(of.yaw)
        shift = float(of.model.high[1]) - float(model.high[1]) - gap
        x, y = of.x + c * along - s * shift, of.y + s * along + c * shift
        return self.plan.place(model, x, y, of.yaw, self.area, 0.0)

    def corner(self, name: str, variant: int, clearance: float = 0.35) -> PropPlacement | None:
        """Places a piece in a free corner."""
        return self.plan.in_some_corner(self.plan.props.model(name, variant), self.area, clearance)

    def small(self, names: Sequence[str], clearance: float = 0.45) -> None:
        """Places small things along the walls where they fit."""
        for name in names:
            model = self.plan.props.model(name, self.plan.pick(12))
            self.plan.against_somewhere(model, self.area, self.sides(), clearance)

    def pictures(self, count: int) -> None:
        """Hangs paintings on free parts of the walls."""
        for _ in range(count):
            model = self.plan.props.model("SM_PictureFrame", self.plan.pick(6))
            for side in self.sides():
                x, y, yaw = wall_pose(model, self.area, side, float(self.rng.uniform(0.1, 0.9)), 0.0)
                if self._is_free(x if side in "NS" else y, side) and self.plan.hang_at(model, x, y, yaw):
                    break

    def _is_free(self, at: float, side: str) -> bool:
        """Returns whether a wall-mounted thing is clear of the openings of a wall."""
        return all(abs(at - door) > 2.0 for door in self.room.doors.get(side, ()))


def furnish_home(plan: FloorPlan, rooms: Sequence[Chamber], palette: Palette) -> None:
    """Furnishes every room by its kind."""
    kinds: dict[str, Callable[[Furnisher], None]] = {
        "living": _living, "dining": _dining, "kitchen": _kitchen, "bedroom": _bedroom, "bath": _bath,
        "study": _study, "laundry": _laundry, "hall": _hall,
    }  # fmt: skip
    has = {room.kind for room in rooms}
    for room in rooms:
        furnisher = Furnisher(plan, room, palette)
        kinds[room.kind](furnisher)
        if room.kind == "living" and "dining" not in has:
            _dining_group(furnisher, along_wall=True)
        if room.kind == "bath" and "laundry" not in has:
            furnisher.wall_piece("SM_WashingMachine", plan.pick(3), clearance=0.05)


def _living(own: Furnisher) -> None:
    """A sofa opposite a television, or around a fireplace; arm chairs, a low table on a rug, shelves, a piano."""
    plan, rng, cover, look = own.plan, own.rng, own.palette.cover, own.palette.wood
    media = None
    for side in own.sides():
        media = own.wall_piece("SM_TvUnit", look, side, 0.3, 0.02)
        if media is not None:
            own.on_top("SM_TelevisionFlat", plan.pick(3), media, float(media.model.high[2]))
            _seats(own, side, media)
            break
    if rng.random() < 0.6:
        own.wall_piece("SM_Fireplace", plan.pick(3), clearance=0.4, gap=0.0)
    own.wall_piece("SM_ShelfBook_B", look, clearance=0.3)
    if rng.random() < 0.5:
        piano = own.wall_piece("SM_Piano", plan.pick(4), clearance=0.35)
        if piano is not None:
            x, y = piano.x + 0.55 * math.sin(piano.yaw), piano.y - 0.55 * math.cos(piano.yaw)
            plan.place(plan.props.model("SM_Stool_F", 1), x, y, piano.yaw, own.area, 0.0, True)
    own.corner("SM_LampFloor", plan.pick(3))
    own.corner("SM_Plant_A", plan.pick(12))
    own.corner("SM_Plant_A", plan.pick(12))
    own.wall_piece("SM_Sideboard", look + 1, clearance=0.3)
    own.small(("SM_Vase", "SM_Basket", "SM_ClockTall", "SM_ToyPile")[plan.pick(2) :: 2])
    own.pictures(3)


def _seats(own: Furnisher, side: str, media: PropPlacement) -> None:
    """A sofa that faces the media bench, with a rug, a coffee table, an arm chair and an ottoman."""
    plan, rng, cover = own.plan, own.rng, own.palette.cover
    reach = min(float(rng.uniform(2.5, 3.1)), (own.area.depth if side in "NS" else own.area.width) - 0.9)
    into = (math.sin(media.yaw), -math.cos(media.yaw))
    x, y = media.x + into[0] * reach, media.y + into[1] * reach
    middle = (media.x + into[0] * (reach - 1.15), media.y + into[1] * (reach - 1.15))
    if plan.place(plan.props.model("SM_Sofa_A", cover), x, y, media.yaw + math.pi, own.area, 0.1) is None:
        own.wall_piece("SM_Sofa_A", cover, clearance=0.3)
    half = (1.25, 0.85) if side in "NS" else (0.85, 1.25)
    carpet = Rectangle(middle[0] - half[0], middle[1] - half[1], middle[0] + half[0], middle[1] + half[1])
    if own.area.contains(carpet):
        rug(plan, carpet, own.palette.rug)
    along = (math.cos(media.yaw), math.sin(media.yaw))
    plan.place(plan.props.model("SM_TableCoffee_D", own.palette.wood), *middle, media.yaw, own.area, 0.1)
    for turn in (1.0, -1.0) if rng.random() < 0.5 else (-1.0, 1.0):
        shift = turn * float(rng.uniform(1.45, 1.7))
        seat = (middle[0] + along[0] * shift, middle[1] + along[1] * shift)
        model = plan.props.model("SM_ChairLounge_G", cover + 1)
        plan.place(model, *seat, media.yaw + turn * math.pi / 2 + math.pi, own.area, 0.15)
        if rng.random() < 0.5:
            break
    own.small(("SM_Ottoman",), 0.3)


def _dining(own: Furnisher) -> None:
    """A table with chairs, a sideboard, a plant and pictures."""
    _dining_group(own, along_wall=False)
    board = own.wall_piece("SM_Sideboard", own.palette.wood, clearance=0.5)
    if board is not None and own.rng.random() < 0.5:
        own.on_top("SM_LampSmall", own.plan.pick(4), board, float(board.model.high[2]), -0.35)
    own.corner("SM_Plant_A", own.plan.pick(12))
    own.small(("SM_ClockTall", "SM_Vase") if own.rng.random() < 0.5 else ("SM_Vase",))
    own.pictures(2)


def _dining_group(own: Furnisher, along_wall: bool) -> None:
    """A dining table with four chairs in the middle of a room, or near a wall of a larger one."""
    plan, rng = own.plan, own.rng
    table = plan.props.model("SM_TableDining_E", own.palette.wood)
    kind, look = (("SM_ChairWood_D", own.palette.wood), ("SM_ChairWaiting_E", own.palette.cover))[plan.pick(2)]
    for _ in range(14):
        margin = 1.5 if along_wall else 1.9
        x = float(rng.uniform(own.area.x0 + margin, max(own.area.x1 - margin, own.area.x0 + margin)))
        y = float(rng.uniform(own.area.y0 + margin, max(own.area.y1 - margin, own.area.y0 + margin)))
        if not along_wall:
            x, y = 0.6 * own.area.centre[0] + 0.4 * x, 0.6 * own.area.centre[1] + 0.4 * y
        yaw = 0.0 if own.area.width >= own.area.depth else math.pi / 2
        found = plan.place(table, x, y, yaw, own.area, 0.75)
        if found is not None:
            _chairs(own, found, kind, look)
            return


def _chairs(own: Furnisher, table: PropPlacement, kind: str, look: int) -> None:
    """Two chairs on each long side of a table, and one at its end."""
    c, s = math.cos(table.yaw), math.sin(table.yaw)
    half = float(table.model.high[1])
    seats = [(a, side * (half + 0.10), 0.0 if side > 0 else math.pi) for a in (-0.33, 0.33) for side in (-1, 1)]
    seats.append((float(table.model.high[0]) + 0.16, 0.0, -math.pi / 2))
    for a, b, turn in seats:
        if own.rng.random() < 0.86:
            x, y = table.x + c * a - s * b, table.y + s * a + c * b
            yaw = table.yaw + turn + float(own.rng.uniform(-0.15, 0.15))
            own.plan.place(own.plan.props.model(kind, look), x, y, yaw, own.area, 0.0, True)


def _kitchen(own: Furnisher) -> None:
    """A row of units with sink, oven, dishwasher and refrigerator; a second row or an island; table where it fits."""
    plan, rng, look = own.plan, own.rng, own.palette.wood
    sides = own.sides()
    row = ["SM_SinkUnit", "SM_Dishwasher", "SM_KitchenUnit", "SM_Oven", "SM_KitchenUnit"]
    main = _unit_row(own, sides, row, look)
    rest = "".join(side for side in sides if side != main)
    if main is None:
        for name in ("SM_SinkUnit", "SM_Oven", "SM_Dishwasher"):
            own.wall_piece(name, look, clearance=0.02)
    cold = own.wall_piece("SM_Refrigerator", plan.pick(4), rest, 0.05)
    if rng.random() < 0.5 and min(own.area.width, own.area.depth) > 4.2:
        plan.place(plan.props.model("SM_CounterIsland", look), *own.area.centre, FACING[main or "N"], own.area, 0.9)
    elif min(own.area.width, own.area.depth) > 3.3:
        table = plan.place(plan.props.model("SM_TableRound_C", plan.pick(6)), *own.area.centre, 0.0, own.area, 0.8)
        if table is not None:
            for turn in (0.4, 3.5):
                x, y = table.x + 0.55 * math.cos(turn), table.y + 0.55 * math.sin(turn)
                plan.place(plan.props.model("SM_ChairWood_D", look), x, y, turn - math.pi / 2, own.area, 0.0, True)
    if cold is None:
        own.small(("SM_Refrigerator",), 0.05)
    own.small(("SM_TrashCan_A", "SM_Basket"), 0.3)
    own.pictures(1)


def _unit_row(own: Furnisher, sides: str, row: list[str], look: int) -> str | None:
    """Places a row of units side by side at the first wall that is free, with wall units above; returns the side."""
    plan, props = own.plan, own.plan.props
    order = [row[k] for k in own.rng.permutation(len(row))]
    for side in sides:
        for names in (order, [name for name in order if name != "SM_KitchenUnit"]):
            models = [props.model(name, look) for name in names]
            widths = [float(model.high[0] - model.low[0]) for model in models]
            length = sum(widths)
            spare = own.length(side) - length
            for start in (0.02, spare / 2, spare - 0.02):
                if 0.0 < start < spare and _try_row(own, side, start, models, widths, look):
                    return side
    return None


def _try_row(own: Furnisher, side: str, start: float, models: list, widths: list[float], look: int) -> bool:  # type: ignore[type-arg]
    """Places all units of a row from `start` metres along a wall, or none."""
    plan, area = own.plan, own.area
    poses, at = [], start
    for model, width in zip(models, widths, strict=True):
        middle, back = at + width / 2, float(model.high[1]) + 0.01
        x = {"W": area.x0 + back, "E": area.x1 - back}.get(side, area.x0 + middle)
        y = {"S": area.y0 + back, "N": area.y1 - back}.get(side, area.y0 + middle)
        poses.append((model, x, y))
        at += width
    yaw, length = FACING[side], at - start
    if not plan.is_free_strip(area, side, start, length, 0.66):
        return False
    tops = ["SM_Microwave", "SM_CoffeeMachine"]
    for model, x, y in poses:
        placed = plan.place(model, x, y, yaw, None, 0.0, True)
        assert placed is not None
        if model.name.startswith(("SM_KitchenUnit", "SM_Dishwasher")) and tops:
            own.on_top(tops.pop(), plan.pick(3), placed, 0.90)
    _above_units(own, side, start, length, look)
    return True


def _above_units(own: Furnisher, side: str, start: float, length: float, look: int) -> None:
    """Adds wall tiles and, on a wall without windows, wall units above a row."""
    plan, area = own.plan, own.area
    count = int(length // 0.6)
    for index in range(count):
        middle = start + (index + 0.5) * length / count
        for name, back in (("SM_SplashTiles", 0.0), ("SM_KitchenWallUnit", 0.31)):
            if name == "SM_KitchenWallUnit" and side in own.room.outer:
                continue
            x = {"W": area.x0 + back, "E": area.x1 - back}.get(side, area.x0 + middle)
            y = {"S": area.y0 + back, "N": area.y1 - back}.get(side, area.y0 + middle)
            plan.add(plan.props.model(name, look), x, y, FACING[side])


def _bedroom(own: Furnisher) -> None:
    """A bed with its head at a wall and night stands, a wardrobe, a dresser, a lounge chair, a rug."""
    plan, rng, look = own.plan, own.rng, own.palette.wood
    variant = look + plan.pick(3)
    found = None
    for side in own.sides():
        for share in (0.5, float(rng.uniform(0.3, 0.7)), 0.35, 0.65):
            found = found or plan.against(plan.props.model("SM_BedDouble", variant), own.area, side, share, 0.75, 0.01)
        if found is not None:
            break
    if found is not None:
        half = float(found.model.high[0])
        for turn in (-1.0, 1.0):
            stand = own.beside("SM_NightStand", look, found, turn * (half + 0.32), 0.02)
            if stand is not None and rng.random() < 0.7:
                own.on_top("SM_LampSmall", look, stand, float(stand.model.high[2]), -turn * 0.05)
    own.wall_piece("SM_Wardrobe", look, clearance=0.5)
    own.wall_piece("SM_Dresser", look, clearance=0.45)
    extra = ("SM_ChairLounge_G", "SM_Ottoman", "SM_Bench", "SM_ShelfBook_B")[plan.pick(4)]
    own.wall_piece(extra, own.palette.cover, clearance=0.45)
    own.small((("SM_Suitcase", "SM_Basket"), ("SM_Backpack", "SM_Basket"), ("SM_Mirror", "SM_Fan"))[plan.pick(3)], 0.3)
    own.pictures(1)


def _bath(own: Furnisher) -> None:
    """A bathtub, a toilet, a basin, a basket and a towel rail."""
    plan = own.plan
    own.wall_piece("SM_BathTub", plan.pick(3), clearance=0.2, gap=0.02)
    own.wall_piece("SM_WashBasin", plan.pick(3), clearance=0.15, gap=0.0)
    own.wall_piece("SM_Toilet", plan.pick(3), clearance=0.2, gap=0.0)
    own.small(("SM_Basket", "SM_TrashCan_A"), 0.15)
    rail = plan.props.model("SM_TowelRail", plan.pick(4))
    for side in own.sides():
        x, y, yaw = wall_pose(rail, own.area, side, float(own.rng.uniform(0.2, 0.8)), 0.0)
        if own._is_free(x if side in "NS" else y, side) and plan.hang_at(rail, x, y, yaw):
            break


def _study(own: Furnisher) -> None:
    """A desk with a monitor and a chair, book cases, an arm chair."""
    plan, props, look = own.plan, own.plan.props, own.palette.wood
    desk = own.wall_piece("SM_TableDesk_A", look, clearance=0.5, gap=0.05)
    if desk is not None:
        own.on_top("SM_Monitor_A", plan.pick(3), desk, 0.745)
        own.on_top("SM_LampSmall", plan.pick(4), desk, 0.745, 0.5)
        x, y = desk.x + 0.5 * math.sin(desk.yaw), desk.y - 0.5 * math.cos(desk.yaw)
        plan.place(props.model("SM_ChairOffice_A", plan.pick(5)), x, y, desk.yaw + math.pi, own.area, 0.0, True)
    for number in range(2):
        own.wall_piece("SM_ShelfBook_B", look + number, clearance=0.3)
    own.wall_piece("SM_ChairLounge_G", own.palette.cover, clearance=0.4)
    own.small(("SM_TrashCan_A", "SM_Plant_A"), 0.4)
    own.pictures(1)


def _laundry(own: Furnisher) -> None:
    """Washing machines, a basket, a cabinet and a fan."""
    plan = own.plan
    first = own.wall_piece("SM_WashingMachine", plan.pick(3), clearance=0.05)
    if first is not None:
        own.beside("SM_WashingMachine", plan.pick(3), first, 0.62, 0.02)
    own.wall_piece("SM_Wardrobe", own.palette.wood + 1, clearance=0.3)
    own.small(("SM_Basket", "SM_Basket", "SM_Fan"), 0.25)


def _hall(own: Furnisher) -> None:
    """A bench, a mirror, bags and a plant along a hall whose middle stays free."""
    plan = own.plan
    own.small(("SM_Backpack", "SM_Suitcase", "SM_Vase")[plan.pick(2) :], 0.5)
    if min(own.area.width, own.area.depth) > 1.9:
        own.small(("SM_Mirror",), 0.5)
    own.corner("SM_Plant_A", plan.pick(12))
    own.pictures(2)
