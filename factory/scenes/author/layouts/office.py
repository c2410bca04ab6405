"""Layout of the family `office`: open plan rooms, private offices, meeting rooms and service rooms along halls.

The kinds, sizes, order and doors of the rooms, the halls and the style differ by seed. `office_rooms` furnishes the
rooms.
"""

from __future__ import annotations

from factory.scenes.author.circulation import RoomSpec, Scheme, l_hall, no_hall, ring_hall, spine_hall, t_hall
from factory.scenes.author.dwelling import BuildingLook, RoomLook, build_rooms
from factory.scenes.author.layouts.office_rooms import furnish_office
from factory.scenes.author.materials import SurfaceMaterial
from factory.scenes.author.partition import Division, Doors, divide_floor, turned
from factory.scenes.author.placement import FloorPlan, Rectangle
from factory.scenes.author.style import OFFICE, Palette, draw_palette

_CEILINGS = ("tiles", "tiles", "panels", "ducts", "plain", "boards")
_OPEN = {
    frozenset(("open", "hall")): (1.5, 2.4),
    frozenset(("lounge", "hall")): (1.6, 2.8),
    frozenset(("reception", "hall")): (1.8, 2.6),
    frozenset(("open", "lounge")): (1.8, 3.2),
    frozenset(("open", "reception")): (1.6, 2.6),
    frozenset(("kitchen", "lounge")): (1.5, 2.4),
    frozenset(("open",)): (1.6, 3.0),
}


def lay_out_office(plan: FloorPlan) -> None:
    """Builds the rooms of one storey, then furnishes them.

    Raises:
        WorldError: no division of the floor into the chosen rooms was found; another seed may have one.
    """
    palette, rng = draw_palette(plan.rng, OFFICE), plan.rng
    ceiling, height = _CEILINGS[plan.pick(len(_CEILINGS))], float(rng.choice((2.7, 2.8, 3.0, 3.3)))
    building = BuildingLook(_looks(palette, plan), palette.trim, palette.leaf, ceiling, palette.views, height)
    rooms = build_rooms(plan, _divide(plan), building)
    furnish_office(plan, rooms, palette, float(rng.uniform(0.55, 1.0)))


def _divide(plan: FloorPlan) -> Division:
    """Chooses the rooms, the halls and the outline at random."""
    rng = plan.rng
    specs, hall = _program(plan), float(rng.uniform(1.8, 2.5))
    area, ratio = sum(spec.area_m2 for spec in specs), float(rng.uniform(1.0, 1.6))
    width = (area * ratio) ** 0.5
    scheme = _scheme(plan, len(specs), area, hall)
    outline = Rectangle(0.0, 0.0, width, area / width)
    doors = Doors(float(rng.uniform(1.0, 1.25)), _OPEN, float(rng.uniform(0.2, 0.9)))
    return turned(rng, divide_floor(rng, outline, specs, doors, scheme))


def _scheme(plan: FloorPlan, rooms: int, area_m2: float, hall_m: float) -> Scheme:
    """Chooses at random an arrangement of the halls that suits the size of the building."""
    schemes = [spine_hall(hall_m), spine_hall(hall_m), t_hall(hall_m), l_hall(hall_m), l_hall(hall_m)]
    if rooms <= 8:
        schemes += [no_hall, no_hall]
    if area_m2 > 230:
        schemes += [ring_hall(hall_m), ring_hall(hall_m)]
    return schemes[plan.pick(len(schemes))]


def _program(plan: FloorPlan) -> list[RoomSpec]:
    """Chooses at random the rooms of an office with few, some or many rooms for one person."""
    rng = plan.rng
    open_rooms, private = ((3, 1), (2, 2), (2, 3), (1, 4), (1, 3))[plan.pick(5)]

    def room(kind: str, low: float, high: float, least: float, is_hub: bool = False) -> RoomSpec:
        return RoomSpec(kind, float(rng.uniform(low, high)), least, is_hub)

    specs = [room("open", 42, 74, 5.4, True) for _ in range(open_rooms)]
    specs += [room("private", 12.5, 18, 3.1) for _ in range(private)]
    specs += [room("meeting", 17, 30, 3.7) for _ in range(1 + plan.pick(2))]
    specs += [room("kitchen", 17, 25, 3.3), room("wash", 9.5, 13, 2.6)]
    for kind, low, high, least, is_hub, share in (
        ("lounge", 22, 34, 4.0, True, 0.55),
        ("reception", 24, 34, 4.2, True, 0.45),
        ("print", 9, 13, 2.6, False, 0.5),
        ("store", 9, 14, 2.6, False, 0.4),
        ("library", 14, 22, 3.3, False, 0.35),
    ):
        if rng.random() < share:
            specs.append(room(kind, low, high, least, is_hub))
    return specs


def _looks(palette: Palette, plan: FloorPlan) -> dict[str, RoomLook]:
    paints, pile = palette.paints, palette.pile
    window, pitch = (("SM_WindowHome", 2.5), ("SM_WindowBand", 3.1), ("SM_WindowBand", 2.7))[plan.pick(3)]
    curtain = palette.curtain if window == "SM_WindowHome" and plan.pick(3) == 0 else None
    dry = (palette.stone, palette.boards, pile)[plan.pick(3)]

    def look(floor: SurfaceMaterial, number: int, windows: int, drape: int | None = None) -> RoomLook:
        return RoomLook(floor, paints[number], windows, drape, window, pitch)

    return {
        "open": look(pile, 0, 5),
        "meeting": look(pile, 1, 2, curtain),
        "private": look(pile, 2, 1, curtain),
        "lounge": look(palette.boards, 3, 3, curtain),
        "kitchen": look(palette.stone, 4, 2),
        "reception": look(dry, 3, 3),
        "library": look(palette.boards, 1, 2, curtain),
        "print": look(palette.stone, 5, 1),
        "store": look(palette.stone, 5, 0),
        "wash": RoomLook(palette.stone, palette.tiles, 0),
        "hall": RoomLook(dry, paints[5], 4, None, window, max(pitch, 3.0)),
    }
