"""Authors the built-in scenes from a seed: office, hospital, two warehouses, homes, shops and schools.

A scene is written as USD, which the importer reads like any stage, or converted to the content that the compiler reads.
Plans with faults (a missing category, an unreachable room) are drawn again. Does not compile or simulate.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from factory.scenes.author.layouts.home import lay_out_home
from factory.scenes.author.layouts.hospital import lay_out_hospital
from factory.scenes.author.layouts.office import lay_out_office
from factory.scenes.author.layouts.paper.hospital import lay_out_hospital as lay_out_paper_hospital
from factory.scenes.author.layouts.paper.office import lay_out_office as lay_out_paper_office
from factory.scenes.author.layouts.paper.warehouse import lay_out_full_warehouse as lay_out_full
from factory.scenes.author.layouts.paper.warehouse import lay_out_multiple_shelves as lay_out_multiple
from factory.scenes.author.layouts.school import lay_out_school
from factory.scenes.author.layouts.shop import lay_out_shop
from factory.scenes.author.layouts.warehouse import lay_out_full_warehouse, lay_out_multiple_shelves
from factory.scenes.author.placement import FloorPlan, Rectangle, settled
from factory.scenes.rules import builtin_rules
from schemas.errors import WorldError
from schemas.terms import BUILTIN_CATEGORIES
from workers.geometry.grid import CONNECT_CLEARANCE_M, Grid

if TYPE_CHECKING:
    from factory.scenes.importer import Extraction


_CELL_M = 0.05
_BORDER_M = 0.5
_LEAST_SHARE = 0.5
"""The robot must reach more than this share of the free floor of a room."""


def find_fault(plan: FloorPlan, name: str) -> str | None:
    """Returns a fault of a floor plan of a built-in scene, or `None` if it can be compiled."""
    rules = [builtin_rules().match(model) for model in {placement.model.name for placement in plan.placements}]
    categories = {rule.category for rule in rules if rule is not None}
    missing = sorted({category for group in BUILTIN_CATEGORIES[name] for category in group} - categories)
    if missing:
        return f"no place for {', '.join(missing)}"
    cut_off = cut_off_rooms(plan)
    return f"furniture blocks the way to a {cut_off[0]}" if cut_off else None


def cut_off_rooms(plan: FloorPlan) -> list[str]:
    """Returns the kinds of the rooms in which at most half of the free floor is part of the largest connected floor.

    Free floor has at least the clearance of connected floor in scene packages. Door zones count as floor, footprints of
    standing props as obstacles.
    """
    areas = [room.area for room in plan.rooms]
    if not areas:
        return []
    x0, y0 = (min(getattr(area, side) for area in areas) - _BORDER_M for side in ("x0", "y0"))
    x1, y1 = (max(getattr(area, side) for area in areas) + _BORDER_M for side in ("x1", "y1"))
    occupied = np.ones((round((y1 - y0) / _CELL_M) + 1, round((x1 - x0) / _CELL_M) + 1), np.uint8)

    def cells(area: Rectangle) -> tuple[slice, slice]:
        rows, columns = (
            slice(max(int((low - start) // _CELL_M), 0), max(int(-((start - high) // _CELL_M)), 0))
            for low, high, start in ((area.y0, area.y1, y0), (area.x0, area.x1, x0))
        )
        return rows, columns

    for area in (*areas, *plan.kept_clear):
        occupied[cells(area)] = 0
    for area in plan.taken:
        occupied[cells(area)] = 1
    grid = Grid(occupied, (x0, y0), _CELL_M)
    floor, wide = grid.connected_floor(), grid.clearance >= CONNECT_CLEARANCE_M
    return [
        room.kind for room in plan.rooms if floor[cells(room.area)].sum() <= _LEAST_SHARE * wide[cells(room.area)].sum()
    ]


__all__ = [
    "AUTHOR_VERSION",
    "BUILTIN_SCENES",
    "PAPER_LAYOUTS",
    "BuiltinScene",
    "author_content",
    "author_scene",
    "lay_out_scene",
]

AUTHOR_VERSION = "24"
"""Version of the authoring; incremented when the same (name, seed) gives another scene. Part of the cache key."""
_DRAWS = 8
"""Number of plans that are drawn for a seed until one has no fault; up to 15 % of the plans have one."""
# a plan is not repaired, because the result would depend on the order in which furniture is moved


@dataclass(frozen=True)
class BuiltinScene:
    """Built-in scene of the factory.

    Attributes:
        name: name in plans and on the command line.
        summary: one line for listings.
        lay_out: function that fills a floor plan.
        metres_per_unit: length of a unit in the written stage, metres.
        first_draw: number of the first random floor plan that is tried for a seed; chosen so that seed 0 has all
            categories.
        others: categories that many layouts have and a plan can name, in addition to those of `BUILTIN_CATEGORIES`.
    """

    name: str
    summary: str
    lay_out: Callable[[FloorPlan], None]
    metres_per_unit: float = 1.0
    first_draw: int = 0
    others: tuple[str, ...] = ()


_BESIDE_HALL = ("chair", "table", "monitor", "plant", "trash_can", "fire_extinguisher", "whiteboard")
_FAMILIES = (
    BuiltinScene(
        "office",
        "200-420 m2 office: open plan, meeting and service rooms along halls",
        lay_out_office,
        others=("shelf",),
    ),
    BuiltinScene(
        "hospital",
        "300-520 m2 hospital floor: wards, waiting hall, treatment rooms",
        lay_out_hospital,
        others=("table", "monitor", "plant", "sofa", "shelf"),
    ),
    BuiltinScene(
        "full_warehouse",
        "360-900 m2 warehouse: rows of pallet racks, staging floor, office",
        lay_out_full_warehouse,
        others=_BESIDE_HALL,
    ),
    BuiltinScene(
        "warehouse_multiple_shelves",
        "230-560 m2 hall: alternating rows of racks and shelves",
        lay_out_multiple_shelves,
        others=_BESIDE_HALL,
    ),
    BuiltinScene("home", "90-170 m2 home: 5 to 9 rooms, with or without a hall", lay_out_home, first_draw=1),
    BuiltinScene("shop", "140-250 m2 shop: sales floor, store, office, wash room", lay_out_shop),
    BuiltinScene("school", "190-330 m2 school: class rooms, library, staff room along a hall", lay_out_school),
)
_PAPER = (
    BuiltinScene("office", "24 x 16 m office: rooms along a corridor", lay_out_paper_office, 0.01),
    BuiltinScene("hospital", "30 x 20 m hospital floor: wards, waiting hall, reception", lay_out_paper_hospital),
    BuiltinScene("full_warehouse", "32 x 24 m warehouse: pallet-rack rows, cross aisle, floor goods", lay_out_full),
    BuiltinScene("warehouse_multiple_shelves", "22 x 18 m hall: alternating rack and shelf rows", lay_out_multiple),
)

BUILTIN_SCENES: Mapping[str, BuiltinScene] = MappingProxyType({scene.name: scene for scene in _FAMILIES})
"""The families of layouts by name."""
PAPER_LAYOUTS: Mapping[str, BuiltinScene] = MappingProxyType({scene.name: scene for scene in _PAPER})
"""The four layouts of the paper, by scene name. Each is the layout of its scene for seed 0."""
# digests of published datasets depend on these layouts, so they do not change with the families


def author_scene(scene: BuiltinScene, seed: int, directory: Path) -> Path:
    """Writes one layout of a built-in scene as USD.

    Args:
        scene: family, or layout of the paper.
        seed: non-negative; the same (scene, seed) gives the same geometry and texture pixels.
        directory: created if missing; receives `<name>.usdc`, `props/` and `textures/`.

    Returns:
        Path of the root layer.

    Raises:
        WorldError: the seed has no valid layout; another seed may have one.
    """
    # loads 200 MB of OpenUSD, which only writing a scene needs
    from factory.scenes.author.usd_writer import write_scene

    return write_scene(lay_out_scene(scene, seed), scene.name, directory, scene.metres_per_unit)


def author_content(scene: BuiltinScene, seed: int) -> Extraction:
    """Returns the content of one layout, which the compiler reads, without writing USD.

    Args:
        scene: family, or layout of the paper.
        seed: non-negative; the same (scene, seed) gives the same geometry and texture pixels.

    Raises:
        WorldError: the seed has no valid layout; another seed may have one.
    """
    plan = lay_out_scene(scene, seed)
    from factory.scenes.author.content import content_of  # imported here, because only compiling a scene needs it

    return content_of(plan, scene.name, f"{scene.name}\n{seed}\n{AUTHOR_VERSION}")


def lay_out_scene(scene: BuiltinScene, seed: int) -> FloorPlan:
    """Returns the floor plan of a scene without writing it.

    It is the first of a few random plans that has rooms, an object of each category and a way for the robot to every
    room.

    Raises:
        WorldError: none of the random plans is valid; another seed may have a valid plan.
    """
    faults: list[str] = []
    for draw in range(scene.first_draw, scene.first_draw + _DRAWS):
        numbers = [seed, zlib.crc32(scene.name.encode()), *([draw] if draw else [])]
        plan = FloorPlan(seed, np.random.default_rng(numbers))
        try:
            scene.lay_out(plan)
        except WorldError as error:
            faults.append(str(error))
            continue
        fault = find_fault(plan, scene.name)
        if fault is None:
            # the paper's layouts stay as they are, because digests of published datasets depend on them
            if BUILTIN_SCENES[scene.name] is scene:
                plan.placements = settled(plan)
            return plan
        faults.append(fault)
    raise WorldError(
        f"none of {_DRAWS} random floor plans is valid; fault of the last one: {faults[-1]}; use another seed"
    )
