"""Places furniture of one style in one room: against walls, on other furniture, in corners, rows and groups.

Uses the floor plan's tests for free floor, in metres. Does not choose what a room contains.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from itertools import accumulate

from factory.scenes.author.dwelling import BuiltRoom, rug
from factory.scenes.author.placement import FACING, FloorPlan, PropPlacement, Rectangle, wall_pose
from factory.scenes.author.props.catalogue import PropModel
from factory.scenes.author.style import Palette

DESK_TOP_M = 0.745
_ON_DESKS = ("SM_BookPile", "SM_Bouquet", "SM_LampSmall", "SM_Portrait", "SM_BookPile", "SM_Laptop")
"""Props on the right half of a desk; the left half has a mug and papers."""
_ON_WORKTOPS = ("SM_Kettle", "SM_Crockery", "SM_Tray", "SM_FruitBowl")
_WORK_CHAIRS = ("SM_ChairOffice_A", "SM_ChairOffice_A", "SM_ChairExecutive_B")
_SEAT_M = 0.62
"""Length of a table edge that each chair takes, metres."""
_SIGN_M = 0.16
"""Distance by which the sign above an entrance is higher than a sign above a door, metres."""
_ENTRY_M = 1.0
"""Depth of the floor before an entrance that stays clear, metres."""


def workplace(furnisher: Furnisher, desk: PropPlacement | None, chair: int, is_second: bool = False) -> None:
    """Adds a screen, a keyboard, a chair and in some cases a smaller thing to a desk.

    Args:
        furnisher: room of the desk.
        desk: desk; with `None`, nothing is added.
        chair: variant of the chair.
        is_second: whether the desk may have a second screen.
    """
    if desk is None:
        return
    rng, aside = furnisher.rng, float(furnisher.rng.uniform(-0.16, 0.06))
    screen = furnisher.plan.pick(3)
    if is_second and rng.random() < 0.3:
        for shift in (-0.3, 0.3):
            furnisher.on_top(
                "SM_Monitor_A", screen, below=desk, height=DESK_TOP_M, along=1.08 * shift, back=0.1, turn=-0.7 * shift
            )
    else:
        furnisher.on_top(
            "SM_Monitor_A",
            screen,
            below=desk,
            height=DESK_TOP_M,
            along=aside,
            back=0.08,
            turn=float(rng.uniform(-0.2, 0.2)),
        )
        if furnisher.is_wanted() and rng.random() < 0.6:
            thing = _ON_DESKS[furnisher.plan.pick(len(_ON_DESKS))]
            furnisher.on_top(
                thing, None, below=desk, height=DESK_TOP_M, along=0.48, back=0.02, turn=float(rng.uniform(-0.3, 0.3))
            )
    furnisher.on_top("SM_TypingPad", 0, below=desk, height=DESK_TOP_M, along=aside / 2, back=-0.2)
    if rng.random() < 0.93:
        name, turn = _WORK_CHAIRS[furnisher.plan.pick(3)], float(rng.uniform(-0.5, 0.5))
        furnisher.before(name, chair, of=desk, reach=float(rng.uniform(0.42, 0.64)), along=aside / 2, turn=turn)


def chairs_around(furnisher: Furnisher, table: PropPlacement, kind: str, look: int, share: float = 0.9) -> None:
    """Adds chairs along both long sides of a table and at its ends, each with the probability `share`."""
    half_x, half_y = float(table.model.high[0]), float(table.model.high[1])
    count = max(1, int(2 * half_x / _SEAT_M - 0.1))
    places = [
        ((seat - (count - 1) / 2) * _SEAT_M, side * (half_y + 0.12), 0.0 if side > 0 else math.pi)
        for seat in range(count)
        for side in (-1, 1)
    ]
    places += [(end * (half_x + 0.18), 0.0, -end * math.pi / 2) for end in (-1, 1)]
    c, s = math.cos(table.yaw), math.sin(table.yaw)
    for a, b, turn in places:
        if furnisher.rng.random() < share:
            x, y = table.x + c * a - s * b, table.y + s * a + c * b
            yaw = table.yaw + turn + float(furnisher.rng.uniform(-0.15, 0.15))
            furnisher.plan.seat(furnisher.model(kind, look), x, y=y, yaw=yaw, room=furnisher.area, of=table)


def round_table(
    furnisher: Furnisher, centre: tuple[float, float], kind: str, look: int, most: int = 4
) -> PropPlacement | None:
    """Places a round table with two to `most` chairs; returns the table, or `None` if it does not fit."""
    table = furnisher.plan.place(furnisher.model("SM_TableRound_C", look), *centre, 0.0, furnisher.area, 0.75)
    if table is None:
        return None
    count, first = 2 + furnisher.plan.pick(most - 1), float(furnisher.rng.uniform(0.0, 2 * math.pi))
    reach = float(table.model.high[0]) + 0.2
    for number in range(count):
        turn = first + 2 * math.pi * number / count
        furnisher.facing(table, kind, look, turn=turn, reach=reach)
    return table


def seat_group(furnisher: Furnisher, sides: str | None = None, rug: int | None = 0) -> PropPlacement | None:
    """Places a sofa at a wall with a low table, one or two arm chairs and a rug before it; returns the sofa."""
    cover, rng = furnisher.palette.cover, furnisher.rng
    sofa = furnisher.wall_piece("SM_Sofa_A", cover, sides=sides, clearance=0.4, gap=0.05) or furnisher.wall_piece(
        "SM_Sofa_A", cover, sides=sides, clearance=0.1, gap=0.05
    )
    if sofa is None:
        return None
    along, into = (math.cos(sofa.yaw), math.sin(sofa.yaw)), (math.sin(sofa.yaw), -math.cos(sofa.yaw))
    reach = float(rng.uniform(1.05, 1.25))
    x, y = sofa.x + into[0] * reach, sofa.y + into[1] * reach
    if rug is not None:
        is_across = abs(along[0]) > 0.5
        furnisher.carpet((x, y), *((2.4, 1.7) if is_across else (1.7, 2.4)), rug)
    furnisher.plan.place(furnisher.model("SM_TableCoffee_D"), x, y, sofa.yaw, furnisher.area, 0.1)
    for turn in (1.0, -1.0)[: 1 + furnisher.plan.pick(2)]:
        shift = turn * float(rng.uniform(1.2, 1.45))
        seat = (x + along[0] * shift, y + along[1] * shift)
        chair = furnisher.model("SM_ChairLounge_G", cover + 1)
        furnisher.plan.place(chair, *seat, sofa.yaw + turn * math.pi / 2 + math.pi, furnisher.area, 0.15)
    return sofa


def kitchen_row(furnisher: Furnisher, sides: str, look: int, names: Sequence[str], tops: Sequence[str]) -> str | None:
    """Places kitchen units side by side at a wall, with small appliances, wall tiles and wall units; returns the side.

    Args:
        furnisher: room.
        sides: sides to try, in order.
        look: variant of the units.
        names: units, placed in random order. If no wall has room for all, `SM_KitchenUnit` is omitted.
        tops: appliances for the first units.
    """
    order = [names[k] for k in furnisher.rng.permutation(len(names))]
    short = [name for name in order if name != "SM_KitchenUnit"]
    row_end = furnisher.row(order, look, sides) or furnisher.row(short, look, sides)
    if row_end is None:
        return None
    side, units, start = row_end
    left = list(tops)
    for unit in units:
        if unit.model.name.startswith(("SM_KitchenUnit", "SM_Dishwasher")):
            if left:
                furnisher.on_top(left.pop(0), None, unit, 0.90)
            else:
                furnisher.dress(unit, _ON_WORKTOPS, 1, 0.90)
    length = sum(float(unit.model.high[0] - unit.model.low[0]) for unit in units)
    for index in range(int(length // 0.6)):
        middle = start + (index + 0.5) * length / (length // 0.6)
        furnisher.plan.add(furnisher.model("SM_SplashTiles", look), *furnisher.at_wall(side, middle, 0.0), FACING[side])
        if side not in furnisher.room.outside:
            furnisher.plan.add(
                furnisher.model("SM_KitchenWallUnit", look), *furnisher.at_wall(side, middle, 0.31), FACING[side]
            )
    return side


def enter(rooms: Sequence[Furnisher], kinds: Sequence[str], variant: int) -> bool:
    """Adds a closed door to the outside, with a sign above it, to an outer wall of the first room with space for it.

    Keeps the floor before the door clear. Returns whether a room had the space.

    Args:
        rooms: rooms of the building.
        kinds: kinds of rooms to try, in order.
        variant: variant of the door.
    """
    return any(_entry(furnisher, variant) for kind in kinds for furnisher in rooms if furnisher.room.kind == kind)


def _entry(furnisher: Furnisher, variant: int) -> bool:
    model = furnisher.model("SM_EntryDoor", variant)
    half, plan = float(model.high[0]) + 0.1, furnisher.plan
    walls = [(side, low, high) for side in furnisher.sides() for low, high in furnisher.room.outside.get(side, ())]
    for side, low, high in walls:
        for share in furnisher.rng.uniform(0.1, 0.9, 6).tolist() if high - low > 2 * half else ():
            along = low + half + share * (high - low - 2 * half)
            x = {"W": furnisher.area.x0, "E": furnisher.area.x1}.get(side, along)
            y = {"S": furnisher.area.y0, "N": furnisher.area.y1}.get(side, along)
            reach = (half, _ENTRY_M) if side in "NS" else (_ENTRY_M, half)
            free = Rectangle(x - reach[0], y - reach[1], x + reach[0], y + reach[1])
            if not any(free.overlaps(other) for other in plan.taken) and plan.hang_at(model, x, y, FACING[side]):
                plan.keep_clear(free)
                plan.add(furnisher.model("SM_Sign", 0), x, y, FACING[side], _SIGN_M)
                return True
    return False


_WALL_ROW_DEPTH_M = 0.66
_THING_M = 0.34
"""Width reserved for each small object on furniture, metres."""
_VARIANTS = 32_760
"""Common multiple of the numbers of variants of all models. A random number below it selects each variant of a model
with equal probability."""
_FEW = {"SM_PictureFrame": 5, "SM_Tapestry": 1}
"""Number of variants of a model that one building uses; it is small, because each variant has its own texture."""
_JOINT_M = 0.8
"""Nothing is mounted within this distance of the joint of two parts of a hall, because a joint has no wall, metres."""
_DOOR_M = 2.0
"""Nothing is mounted on a wall within this distance of the centre of a door, metres."""


class Furnisher:
    """Room with its floor plan and its style; `clutter` is the probability with which each small thing is placed."""

    def __init__(self, plan: FloorPlan, room: BuiltRoom, palette: Palette, clutter: float = 1.0) -> None:
        self.plan, self.room, self.area, self.palette = plan, room, room.area, palette
        self.rng, self.clutter = plan.rng, clutter
        self.to_hang: list[str] = []
        """Wall objects that `hang_all` mounts after all furniture is placed."""

    def length(self, side: str) -> float:
        """Returns the length of a wall, metres."""
        return self.area.width if side in "NS" else self.area.depth

    def sides(self) -> str:
        """Returns the four sides in random order, those without an opening first."""
        order = ["NESW"[k] for k in self.rng.permutation(4)]
        return "".join(sorted(order, key=lambda side: side in self.room.doors))

    def model(self, name: str, variant: int | None = None) -> PropModel:
        """Returns a model, by default in a random variant. A building uses few variants of the models in `_FEW`."""
        if variant is None:
            few = _FEW.get(name)
            variant = self.plan.pick(_VARIANTS) if few is None else self.palette.art + self.plan.pick(few)
        return self.plan.props.model(name, variant)

    def wall_piece(
        self,
        name: str,
        variant: int | None = None,
        sides: str | None = None,
        clearance: float = 0.1,
        gap: float = 0.02,
    ) -> PropPlacement | None:
        """Places a piece with its back to the first wall that has space for it, at a random position."""
        model = self.model(name, variant)
        for side in sides or self.sides():
            for share in (float(self.rng.uniform(0.3, 0.7)), *self.rng.uniform(0.0, 1.0, 5).tolist(), 0.0, 1.0):
                x, y, yaw = wall_pose(model, self.area, side=side, along=share, gap=gap)
                if self.plan.meets(model, x, y, yaw) or self.plan.hides(model, x, y, yaw):
                    continue
                placed = self.plan.place(model, x, y, yaw, None, clearance)
                if placed is not None:
                    return placed
        return None

    def is_wanted(self) -> bool:
        """Returns whether to place a small thing; draws a random number only if the probability is below 1."""
        return self.clutter >= 1.0 or bool(self.rng.random() < self.clutter)

    def on_top(
        self,
        name: str,
        variant: int | None,
        below: PropPlacement,
        height: float,
        along: float = 0.0,
        back: float = 0.0,
        turn: float = 0.0,
    ) -> None:
        """Places a small object on furniture, `along` and `back` metres from its centre, turned by `turn` radians.

        It is omitted where a curtain, a screen or another thing is in the way.
        """
        self._lay(self.model(name, variant), below, height=height, along=along, back=back, turn=turn)

    def _lay(
        self,
        model: PropModel,
        below: PropPlacement,
        height: float,
        along: float,
        back: float = 0.0,
        turn: float = 0.0,
    ) -> None:
        c, s = math.cos(below.yaw), math.sin(below.yaw)
        x, y = below.x + c * along - s * back, below.y + s * along + c * back
        if not self.plan.intersects(model, x, y, below.yaw + turn, z=height, but=below):
            self.plan.add(model, x, y, below.yaw + turn, height)

    def dress(
        self, piece: PropPlacement | None, names: Sequence[str], most: int = 2, top_m: float | None = None
    ) -> None:
        """Places up to `most` different small objects side by side on furniture; `top_m` is the height of the surface,
        by default that of the furniture."""
        if piece is None:
            return
        low, high = (float(bound[0]) for bound in (piece.model.low, piece.model.high))
        slots = int((high - low - 0.1) / _THING_M)
        chosen = [names[k] for k in self.rng.permutation(len(names))[: min(most, slots)]]
        used: list[tuple[float, float]] = []
        for slot, name in zip(self.rng.permutation(slots), chosen, strict=False):
            along = (low + high) / 2 + (float(slot) - (slots - 1) / 2) * _THING_M
            model = self.model(name)
            ends = along + float(model.low[0]), along + float(model.high[0])
            is_free = low < ends[0] and ends[1] < high and all(ends[1] < a or b < ends[0] for a, b in used)
            if is_free and self.is_wanted():
                used.append(ends)
                self._lay(model, piece, float(piece.model.high[2]) if top_m is None else top_m, along)

    def carpet(self, centre: tuple[float, float], width: float, depth: float, design: int = 0) -> None:
        """Lays a rug if the room has enough floor without rugs; `design` is its number in the palette."""
        (x, y), rugs = centre, self.palette.rugs
        area = Rectangle(x - width / 2, y - depth / 2, x + width / 2, y + depth / 2)
        if self.area.contains(area) and not any(area.overlaps(other) for other in self.plan.covered):
            rug(self.plan, area, rugs[design % len(rugs)])

    def beside(
        self, name: str, variant: int | None, of: PropPlacement, along: float, gap: float
    ) -> PropPlacement | None:
        """Places a piece at the same wall as another piece, `along` metres from the centre of that piece."""
        model = self.model(name, variant)
        c, s = math.cos(of.yaw), math.sin(of.yaw)
        shift = float(of.model.high[1]) - float(model.high[1]) - gap
        x, y = of.x + c * along - s * shift, of.y + s * along + c * shift
        return self.plan.place(model, x, y, of.yaw, self.area, 0.0)

    def before(
        self, name: str, variant: int | None, of: PropPlacement, reach: float, along: float = 0.0, turn: float = 0.0
    ) -> PropPlacement | None:
        """Places a seat `reach` metres in front of a piece and `along` metres from its centre. The seat faces the
        piece, turned by `turn` radians."""
        c, s = math.cos(of.yaw), math.sin(of.yaw)
        x, y = of.x + c * along + s * reach, of.y + s * along - c * reach
        return self.plan.seat(self.model(name, variant), x, y=y, yaw=of.yaw + math.pi + turn, room=self.area, of=of)

    def facing(self, table: PropPlacement, name: str, variant: int | None, turn: float, reach: float) -> None:
        """Places a seat that faces a table, `reach` metres from its centre in the direction `turn`, radians."""
        x, y = table.x + reach * math.cos(turn), table.y + reach * math.sin(turn)
        self.plan.seat(self.model(name, variant), x, y=y, yaw=turn - math.pi / 2, room=self.area, of=table)

    def corner(self, name: str, variant: int | None = None, clearance: float = 0.35) -> PropPlacement | None:
        """Places a piece in a free corner."""
        return self.plan.in_some_corner(self.model(name, variant), self.area, clearance, avoid=True)

    def small(self, names: Sequence[str], clearance: float = 0.45) -> None:
        """Places small objects along the walls where they fit."""
        for name in names:
            if self.is_wanted():
                self.plan.against_somewhere(self.model(name), self.area, self.sides(), clearance, avoid=True)

    def hang(self, name: str, count: int = 1) -> None:
        """Records wall objects for `hang_all`."""
        self.to_hang += [name for _ in range(count) if self.is_wanted()]

    def hang_all(self) -> None:
        """Mounts the recorded wall objects on free parts of the walls, away from the openings."""
        # after all furniture is placed, so tall pieces still find a free wall
        for name in self.to_hang:
            model = self.model(name)
            for side in self.sides() * 3:
                x, y, yaw = wall_pose(model, self.area, side=side, along=float(self.rng.uniform(0.1, 0.9)), gap=0.0)
                at = x if side in "NS" else y
                is_clear = all(abs(at - door) > _DOOR_M for door in self.room.doors.get(side, ()))
                is_clear &= self.room.has_wall(side, at, _JOINT_M)
                if is_clear and self.plan.hang_at(model, x, y, yaw):
                    break

    def row(self, names: Sequence[str], variant: int, sides: str) -> tuple[str, list[PropPlacement], float] | None:
        """Places pieces side by side along the first wall with a free strip.

        Returns:
            The side, the pieces, and the distance of the first one from the start of the wall, metres; `None` if no
            wall has room for all.
        """
        models = [self.model(name, variant) for name in names]
        widths = [float(model.high[0] - model.low[0]) for model in models]
        for side in sides:
            spare = self.length(side) - sum(widths)
            for start in (0.02, spare / 2, spare - 0.02):
                is_inside = 0.0 < start < spare
                if is_inside and self.plan.is_free_strip(
                    self.area, side, start=start, length=sum(widths), depth=_WALL_ROW_DEPTH_M
                ):
                    ends = accumulate(widths, initial=start)
                    return (
                        side,
                        [self._stand(model, side, end) for model, end in zip(models, ends, strict=False)],
                        start,
                    )
        return None

    def at_wall(self, side: str, along: float, back: float) -> tuple[float, float]:
        """Returns the point `along` metres from the start of a wall and `back` metres off its face."""
        x = {"W": self.area.x0 + back, "E": self.area.x1 - back}.get(side, self.area.x0 + along)
        y = {"S": self.area.y0 + back, "N": self.area.y1 - back}.get(side, self.area.y0 + along)
        return x, y

    def _stand(self, model: PropModel, side: str, start: float) -> PropPlacement:
        """Places one piece of a row; the caller has tested that the strip of floor is free."""
        width = float(model.high[0] - model.low[0])
        x, y = self.at_wall(side, start + width / 2, float(model.high[1]) + 0.01)
        return self.plan.stand(model, x, y, FACING[side])


def complete(
    plan: FloorPlan, furnishers: Sequence[Furnisher], wanted: Mapping[str, int], kinds: Collection[str] = ()
) -> None:
    """Adds pieces at walls of rooms in random order until the building has the wanted numbers of them.

    Args:
        plan: floor plan of the building.
        furnishers: its rooms.
        wanted: minimum number of each piece; random variants are added.
        kinds: kinds of rooms to use; empty uses all.
    """
    rooms = [each for each in furnishers if not kinds or each.room.kind in kinds]
    for name, least in wanted.items():
        standing = sum(placement.model.name.startswith(name) for placement in plan.placements)
        for clearance in (0.35, 0.1, 0.02):
            for number in plan.rng.permutation(len(rooms)):
                if standing < least:
                    standing += (
                        rooms[number].wall_piece(name, None, sides=None, clearance=clearance, gap=0.03) is not None
                    )
