"""Furnishes parts of rooms with groups of furniture: workplaces, tables with chairs, seats, a kitchen row, an entrance.

Places props of one room in metres. Does not choose what a room contains.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from factory.scenes.author.furnisher import Furnisher
from factory.scenes.author.placement import FACING, PropPlacement, Rectangle

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


def workplace(own: Furnisher, desk: PropPlacement | None, chair: int, is_second: bool = False) -> None:
    """Adds a screen, a keyboard, a chair and in some cases a smaller thing to a desk.

    Args:
        own: room of the desk.
        desk: desk; with `None`, nothing is added.
        chair: variant of the chair.
        is_second: whether the desk may have a second screen.
    """
    if desk is None:
        return
    rng, aside = own.rng, float(own.rng.uniform(-0.16, 0.06))
    screen = own.plan.pick(3)
    if is_second and rng.random() < 0.3:
        for shift in (-0.3, 0.3):
            own.on_top("SM_Monitor_A", screen, desk, DESK_TOP_M, shift, 0.1, -0.7 * shift)
    else:
        own.on_top("SM_Monitor_A", screen, desk, DESK_TOP_M, aside, 0.08, float(rng.uniform(-0.2, 0.2)))
        if own.is_wanted() and rng.random() < 0.6:
            thing = _ON_DESKS[own.plan.pick(len(_ON_DESKS))]
            own.on_top(thing, None, desk, DESK_TOP_M, 0.48, 0.02, float(rng.uniform(-0.3, 0.3)))
    own.on_top("SM_TypingPad", 0, desk, DESK_TOP_M, aside / 2, -0.2)
    if rng.random() < 0.93:
        name, turn = _WORK_CHAIRS[own.plan.pick(3)], float(rng.uniform(-0.5, 0.5))
        own.before(name, chair, desk, float(rng.uniform(0.42, 0.64)), aside / 2, turn)


def chairs_around(own: Furnisher, table: PropPlacement, kind: str, look: int, share: float = 0.9) -> None:
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
        if own.rng.random() < share:
            x, y = table.x + c * a - s * b, table.y + s * a + c * b
            yaw = table.yaw + turn + float(own.rng.uniform(-0.15, 0.15))
            own.plan.seat(own.model(kind, look), x, y, yaw, own.area, table)


def round_table(
    own: Furnisher, centre: tuple[float, float], kind: str, look: int, most: int = 4
) -> PropPlacement | None:
    """Places a round table with two to `most` chairs; returns the table, or `None` if it does not fit."""
    table = own.plan.place(own.model("SM_TableRound_C", look), *centre, 0.0, own.area, 0.75)
    if table is None:
        return None
    count, first = 2 + own.plan.pick(most - 1), float(own.rng.uniform(0.0, 2 * math.pi))
    reach = float(table.model.high[0]) + 0.2
    for number in range(count):
        turn = first + 2 * math.pi * number / count
        x, y = centre[0] + reach * math.cos(turn), centre[1] + reach * math.sin(turn)
        own.plan.seat(own.model(kind, look), x, y, turn - math.pi / 2, own.area, table)
    return table


def seat_group(own: Furnisher, sides: str | None = None, rug: int | None = 0) -> PropPlacement | None:
    """Places a sofa at a wall with a low table, one or two arm chairs and a rug before it; returns the sofa."""
    cover, rng = own.palette.cover, own.rng
    sofa = own.wall_piece("SM_Sofa_A", cover, sides, 0.4, 0.05) or own.wall_piece("SM_Sofa_A", cover, sides, 0.1, 0.05)
    if sofa is None:
        return None
    along, into = (math.cos(sofa.yaw), math.sin(sofa.yaw)), (math.sin(sofa.yaw), -math.cos(sofa.yaw))
    reach = float(rng.uniform(1.05, 1.25))
    x, y = sofa.x + into[0] * reach, sofa.y + into[1] * reach
    if rug is not None:
        is_across = abs(along[0]) > 0.5
        own.carpet((x, y), *((2.4, 1.7) if is_across else (1.7, 2.4)), rug)
    own.plan.place(own.model("SM_TableCoffee_D"), x, y, sofa.yaw, own.area, 0.1)
    for turn in (1.0, -1.0)[: 1 + own.plan.pick(2)]:
        shift = turn * float(rng.uniform(1.2, 1.45))
        seat = (x + along[0] * shift, y + along[1] * shift)
        chair = own.model("SM_ChairLounge_G", cover + 1)
        own.plan.place(chair, *seat, sofa.yaw + turn * math.pi / 2 + math.pi, own.area, 0.15)
    return sofa


def kitchen_row(own: Furnisher, sides: str, look: int, names: Sequence[str], tops: Sequence[str]) -> str | None:
    """Places kitchen units side by side at a wall, with small appliances, wall tiles and wall units; returns the side.

    Args:
        own: room.
        sides: sides to try, in order.
        look: variant of the units.
        names: units, placed in random order. If no wall has room for all, `SM_KitchenUnit` is omitted.
        tops: appliances for the first units.
    """
    order = [names[k] for k in own.rng.permutation(len(names))]
    short = [name for name in order if name != "SM_KitchenUnit"]
    found = own.row(order, look, sides) or own.row(short, look, sides)
    if found is None:
        return None
    side, units, start = found
    left = list(tops)
    for unit in units:
        if unit.model.name.startswith(("SM_KitchenUnit", "SM_Dishwasher")):
            if left:
                own.on_top(left.pop(0), None, unit, 0.90)
            else:
                own.dress(unit, _ON_WORKTOPS, 1, 0.90)
    length = sum(float(unit.model.high[0] - unit.model.low[0]) for unit in units)
    for index in range(int(length // 0.6)):
        middle = start + (index + 0.5) * length / (length // 0.6)
        own.plan.add(own.model("SM_SplashTiles", look), *own.at_wall(side, middle, 0.0), FACING[side])
        if side not in own.room.outside:
            own.plan.add(own.model("SM_KitchenWallUnit", look), *own.at_wall(side, middle, 0.31), FACING[side])
    return side


def enter(rooms: Sequence[Furnisher], kinds: Sequence[str], variant: int) -> bool:
    """Adds a closed door to the outside, with a sign above it, to an outer wall of the first room with space for it.

    Keeps the floor before the door clear. Returns whether a room had the space.

    Args:
        rooms: rooms of the building.
        kinds: kinds of rooms to try, in order.
        variant: variant of the door.
    """
    return any(_entry(own, variant) for kind in kinds for own in rooms if own.room.kind == kind)


def _entry(own: Furnisher, variant: int) -> bool:
    model = own.model("SM_EntryDoor", variant)
    half, plan = float(model.high[0]) + 0.1, own.plan
    walls = [(side, low, high) for side in own.sides() for low, high in own.room.outside.get(side, ())]
    for side, low, high in walls:
        for share in own.rng.uniform(0.1, 0.9, 6).tolist() if high - low > 2 * half else ():
            along = low + half + share * (high - low - 2 * half)
            x = {"W": own.area.x0, "E": own.area.x1}.get(side, along)
            y = {"S": own.area.y0, "N": own.area.y1}.get(side, along)
            reach = (half, _ENTRY_M) if side in "NS" else (_ENTRY_M, half)
            free = Rectangle(x - reach[0], y - reach[1], x + reach[0], y + reach[1])
            if not any(free.overlaps(other) for other in plan.taken) and plan.hang_at(model, x, y, FACING[side]):
                plan.keep_clear(free)
                plan.add(own.model("SM_Sign", 0), x, y, FACING[side], _SIGN_M)
                return True
    return False
