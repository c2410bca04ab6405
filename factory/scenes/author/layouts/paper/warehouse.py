"""Layouts of the warehouses: pallet-rack rows with a cross aisle, and a smaller hall with rack and shelf rows.

Places structures and props, in metres; every rack bay is a separate prop. Does not build meshes.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from factory.scenes.author.materials import painted, textured, tinted
from factory.scenes.author.placement import FACING, FloorPlan, Rectangle, wall_pose
from factory.scenes.author.room import Trim, ceiling_slab, floor, high_bay_lamps, marking, wall

CONCRETE = textured("Concrete", "#a9a8a3", 3.0, 0.7)
PANELS = textured("WallPanel", "#cfd3d4", 2.0, 0.6)
ROOF = tinted("WallPanel", "RoofSheet", colour="#b4bac0", tile_m=4.0, roughness=0.8)
YELLOW = painted("Yellow", 0.6)
HAZARD = textured("Hazard", "#d8ac20", 0.5, 0.7)
KICK = Trim(
    dado=tinted("Plaster", "KickWall", colour="#7d868d", tile_m=1.0, roughness=0.8), dado_top_m=1.1, has_sockets=False
)
HEIGHT_M = 6.0
BAY_M = 2.72
RACK_DEPTH_M = 0.84


class RackRow(NamedTuple):
    """Row of storage units along x: kind of unit, position of the centre line, direction."""

    kind: str
    y: float
    yaw: float


def lay_out_full_warehouse(plan: FloorPlan) -> None:
    """Builds a 32 x 24 m hall with rows of racks, aisles of 2.9-3.2 m, one cross aisle and goods along the walls."""
    hall = Rectangle(0.0, 0.0, 32.0, 24.0)
    _shell(plan, hall, gates=3)
    inside = hall.grown(-0.08)
    aisle = float(plan.rng.uniform(2.9, 3.2))
    rows = list(_rack_rows(plan, hall, aisle))
    _fill_rows(plan, hall, rows, 4.2)
    _wall_shelves(plan, inside, 8)
    _floor_goods(plan, inside, singles=18, clusters=6)


def lay_out_multiple_shelves(plan: FloorPlan) -> None:
    """Builds a 22 x 18 m hall in which rack rows and shelf rows alternate."""
    hall = Rectangle(0.0, 0.0, 22.0, 18.0)
    _shell(plan, hall, gates=2)
    inside = hall.grown(-0.08)
    aisle = float(plan.rng.uniform(2.1, 2.4))
    first = ("rack", "shelf") if plan.rng.random() < 0.5 else ("shelf", "rack")
    rows: list[RackRow] = []
    y = 2.9
    while y < hall.y1 - 2.6:
        kind = first[len(rows) % 2]
        rows.append(RackRow(kind, y, FACING["N"] if plan.rng.random() < 0.5 else FACING["S"]))
        y += 0.8 + aisle
    _fill_rows(plan, hall, rows, 2.5)
    _wall_shelves(plan, inside, 5)
    _floor_goods(plan, inside, singles=14, clusters=4)


def _rack_rows(plan: FloorPlan, hall: Rectangle, aisle: float) -> Iterator[RackRow]:
    """Yields single and back-to-back rack rows over the depth of the hall; single rows are accessible from both
    sides."""
    y = 3.2
    while y < hall.y1 - 2.8:
        yield RackRow("rack", y, FACING["N"])
        if plan.rng.random() < 0.3 and y + RACK_DEPTH_M < hall.y1 - 2.8:
            y += RACK_DEPTH_M + 0.06
            yield RackRow("rack", y, FACING["S"])
        y += RACK_DEPTH_M + aisle


def _shell(plan: FloorPlan, hall: Rectangle, gates: int) -> None:
    """Builds floor, walls, roof, lamps, windows, loading gates and a painted frame on the floor."""
    floor(plan, hall, CONCRETE)
    ceiling_slab(plan, hall, HEIGHT_M, ROOF)
    high_bay_lamps(plan, hall, HEIGHT_M, 5.0)
    faces = (PANELS, PANELS)
    for y in (hall.y0, hall.y1):
        wall(
            plan,
            True,
            at=y,
            span=(hall.x0 - 0.06, hall.x1 + 0.06),
            faces=faces,
            doors=(),
            height=HEIGHT_M,
            trims=(KICK, KICK),
        )
    for x in (hall.x0, hall.x1):
        wall(plan, False, at=x, span=(hall.y0, hall.y1), faces=faces, doors=(), height=HEIGHT_M, trims=(KICK, KICK))
    inside, props = hall.grown(-0.06), plan.props
    gate_side = "EW"[plan.pick(2)]
    gate = props.model("SM_RollerGate", 0)
    for number in range(gates):
        x, y, yaw = wall_pose(gate, inside, side=gate_side, along=(number + 0.5) / gates, gap=0.0)
        plan.add(gate, x, y, yaw)
        x0, x1 = (hall.x1 - 1.8, hall.x1) if gate_side == "E" else (hall.x0, 1.8)
        plan.keep_clear(Rectangle(x0, y - 1.7, x1, y + 1.7))
    for side in "NS":
        for along in (0.1, 0.3, 0.5, 0.7, 0.9):
            plan.hang(props.model("SM_Window", 2), inside, side, along)
            plan.hang(
                props.model("SM_SafetyNotice", plan.pick(3)),
                inside,
                side,
                along + float(plan.rng.uniform(-0.05, 0.05)),
            )


def _fill_rows(plan: FloorPlan, hall: Rectangle, rows: list[RackRow], margin: float) -> None:
    """Places bays or shelf units along each row, keeps the cross aisle free and marks aisles on the floor."""
    rng, props = plan.rng, plan.props
    cross = hall.x0 + float(rng.uniform(0.42, 0.58)) * hall.width
    frame, shelf_look = plan.pick(3), plan.pick(8)
    for row in rows:
        pitch = BAY_M if row.kind == "rack" else 1.24
        for start, end in ((hall.x0 + margin, cross - 1.5), (cross + 1.5, hall.x1 - margin)):
            count = int((end - start) // pitch)
            x0 = start if start > cross else end - count * pitch
            for slot in range(count):
                if rng.random() < 0.94:
                    x = x0 + (slot + 0.5) * pitch
                    look = frame + 3 * plan.pick(3) if row.kind == "rack" else shelf_look + 4 * plan.pick(2)
                    name = "SM_RackPile_04" if row.kind == "rack" else "SM_ShelfSteel_A"
                    plan.place(props.model(name, look), x, row.y, row.yaw, None, -0.05)
            if count:
                _mark_row(plan, row, x0, x0 + count * pitch)


def _mark_row(plan: FloorPlan, row: RackRow, x0: float, x1: float) -> None:
    """Adds a yellow line in front of the row, and hazard patches and impact posts at its ends."""
    toward = -1.0 if row.yaw == FACING["N"] else 1.0
    edge = row.y + toward * 0.58
    marking(plan, Rectangle(x0 - 0.25, edge - 0.04, x1 + 0.25, edge + 0.04), YELLOW)
    for x in (x0 - 0.35, x1 + 0.25):
        marking(plan, Rectangle(x, row.y - 0.4, x + 0.1, row.y + 0.4), HAZARD)
    post = plan.props.model("SM_ImpactPost", 0)
    for x in (x0 - 0.12, x1 + 0.12):
        if row.kind == "rack":
            plan.place(post, x, row.y + toward * 0.33, 0.0, None, -0.05)


def _wall_shelves(plan: FloorPlan, inside: Rectangle, count: int) -> None:
    """Places shelf units with their backs to the east and west walls."""
    for number in range(count):
        model = plan.props.model("SM_ShelfSteel_A", plan.pick(8))
        plan.against_somewhere(model, inside, sides="EW", clearance=0.05 if number % 2 else 0.5, tries=30)


def _floor_goods(plan: FloorPlan, inside: Rectangle, singles: int, clusters: int) -> None:
    """Places barrels and crates along the walls, single and in small groups, and clutter between them."""
    rng, props = plan.rng, plan.props
    names = ("SM_BarelPlastic_A", "SM_CratePlastic_A", "SM_BarelPlastic_A", "SM_CrateWood_B")
    for number in range(singles):
        plan.against_somewhere(props.model(names[number % 4], plan.pick(12)), inside, "NESW", 0.35)
    for _ in range(clusters):
        x, y = float(rng.uniform(1.5, inside.x1 - 1.5)), (1.0, inside.y1 - 1.0)[plan.pick(2)]
        name = names[plan.pick(4)]
        for _ in range(2 + plan.pick(2)):
            dx, dy = float(rng.uniform(-0.8, 0.8)), float(rng.uniform(-0.4, 0.4))
            plan.place(props.model(name, plan.pick(12)), x + dx, y + dy, float(rng.uniform(-0.5, 0.5)), inside, 0.02)
    clutter = (
        "SM_PalletPile",
        "SM_CardBoxPile",
        "SM_PalletTruck",
        "SM_Workbench",
        "SM_Cone",
        "SM_Cone",
        "SM_CardBoxPile",
    )
    for name in clutter:
        plan.against_somewhere(props.model(name, plan.pick(4)), inside, "NESW", 0.6)
    for side in "NS":
        plan.against_somewhere(props.model("SM_PalletPile", plan.pick(4)), inside, side, 0.5)
