"""Layout of the family `hospital`: wards, treatment rooms, a waiting hall and service rooms along halls.

The kinds, sizes, order and doors of the rooms, the halls and the style differ by seed. `hospital_rooms` furnishes the
rooms.
"""

from __future__ import annotations

from factory.scenes.author.circulation import HALL, RoomSpec, l_hall, ring_hall, spine_hall, t_hall
from factory.scenes.author.dwelling import BuildingLook, BuiltRoom, RoomLook, build_rooms
from factory.scenes.author.layouts.hospital_rooms import furnish_hospital
from factory.scenes.author.materials import SurfaceMaterial, painted, tinted, wood
from factory.scenes.author.partition import Division, Doors, divide_floor, turned
from factory.scenes.author.placement import FloorPlan, Rectangle
from factory.scenes.author.room import Trim, marking
from factory.scenes.author.style import CLINIC, Palette, draw_palette

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
    building = BuildingLook(_looks(palette, plan), _trim(plan), palette.leaf, ceiling, palette.views, height)
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
    return turned(rng, divide_floor(rng, Rectangle(0.0, 0.0, width, area / width), specs, doors, scheme))


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
    dado = tinted("Plaster", f"DadoPlaster{tint[1:]}", tint, 1.0, 0.6)
    return Trim(rail, dado, float(plan.rng.choice((0.8, 1.0, 1.2))), skirting, frame=frame[plan.pick(5)])


def _looks(palette: Palette, plan: FloorPlan) -> dict[str, RoomLook]:
    paints = palette.paints
    window, pitch = (("SM_WindowHome", 2.6), ("SM_WindowBand", 3.1))[plan.pick(2)]
    dry = (palette.stone, palette.pile)[plan.pick(2)]

    def look(floor: SurfaceMaterial, number: int, windows: int) -> RoomLook:
        return RoomLook(floor, paints[number], windows, None, window, pitch)

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
        HALL: RoomLook(palette.pile, paints[3], 4, None, window, max(pitch, 3.2)),
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
