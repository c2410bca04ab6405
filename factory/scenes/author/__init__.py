"""Authors the built-in scenes from a seed: office, hospital, two warehouses, homes, shops and schools.

A scene is written as USD, which the importer reads like any stage, or converted to the content that the compiler reads.
Does not compile or simulate.
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
from factory.scenes.author.layouts.school import lay_out_school
from factory.scenes.author.layouts.shop import lay_out_shop
from factory.scenes.author.layouts.warehouse import lay_out_full_warehouse, lay_out_multiple_shelves
from factory.scenes.author.passage import cut_off_rooms
from factory.scenes.author.placement import FloorPlan
from schemas.errors import UsageError, WorldError

if TYPE_CHECKING:
    from factory.scenes.importer import Extraction

__all__ = ["AUTHOR_VERSION", "BUILTIN_SCENES", "BuiltinScene", "author_content", "author_scene"]

AUTHOR_VERSION = "22"
"""Version of the authoring; incremented when the same (name, seed) gives another scene. Part of the cache key."""
_DRAWS = 8


@dataclass(frozen=True)
class BuiltinScene:
    """Built-in scene of the factory.

    Attributes:
        name: name in plans and on the command line.
        summary: one line for listings.
        metres_per_unit: length of a unit in the written stage, metres.
        lay_out: function that fills a floor plan.
        first_draw: number of the first random plan of a seed; chosen so that seed 0 has all categories.
    """

    name: str
    summary: str
    metres_per_unit: float
    lay_out: Callable[[FloorPlan], None]
    first_draw: int = 0


_SCENES = (
    BuiltinScene("office", "24 x 16 m office: rooms along a corridor, authored in centimetres", 0.01, lay_out_office),
    BuiltinScene("hospital", "30 x 20 m hospital floor: wards, waiting hall, reception", 1.0, lay_out_hospital),
    BuiltinScene(
        "full_warehouse",
        "32 x 24 m warehouse: pallet-rack rows, cross aisle, floor goods",
        1.0,
        lay_out_full_warehouse,
    ),
    BuiltinScene(
        "warehouse_multiple_shelves",
        "22 x 18 m hall: alternating rack and shelf rows",
        1.0,
        lay_out_multiple_shelves,
    ),
    BuiltinScene("home", "90-170 m2 home: 5 to 9 rooms, with or without a hall", 1.0, lay_out_home, 1),
    BuiltinScene("shop", "140-250 m2 shop: sales floor, store, office, wash room", 1.0, lay_out_shop),
    BuiltinScene("school", "190-330 m2 school: class rooms, library, staff room along a hall", 1.0, lay_out_school),
)

BUILTIN_SCENES: Mapping[str, BuiltinScene] = MappingProxyType({scene.name: scene for scene in _SCENES})
"""The built-in scenes by name."""


def author_scene(name: str, seed: int, directory: Path) -> Path:
    """Writes one built-in scene as USD.

    Args:
        name: a key of `BUILTIN_SCENES`.
        seed: non-negative; the same (name, seed) gives the same geometry and texture pixels.
        directory: created if missing; receives `<name>.usdc`, `props/` and `textures/`.

    Returns:
        Path of the root layer.

    Raises:
        UsageError: `name` is not a built-in scene.
    """
    scene = _scene_of(name)
    from factory.scenes.author.usd_writer import write_scene  # 200 MB of USD, only when a scene is written

    plan = lay_out_scene(scene, seed)
    return write_scene(plan, name, directory, scene.metres_per_unit)


def author_content(name: str, seed: int) -> Extraction:
    """Returns the content of one built-in scene, which the compiler reads, without writing USD.

    Args:
        name: a key of `BUILTIN_SCENES`.
        seed: non-negative; the same (name, seed) gives the same geometry and texture pixels.

    Raises:
        UsageError: `name` is not a built-in scene.
        WorldError: the seed has no layout; another seed has one.
    """
    plan = lay_out_scene(_scene_of(name), seed)
    from factory.scenes.author.content import content_of  # only when a scene is compiled

    return content_of(plan, name, f"{name}\n{seed}\n{AUTHOR_VERSION}")


def _scene_of(name: str) -> BuiltinScene:
    scene = BUILTIN_SCENES.get(name)
    if scene is None:
        raise UsageError(f"{name!r} is not a built-in scene; known scenes: {', '.join(BUILTIN_SCENES)}")
    return scene


def lay_out_scene(scene: BuiltinScene, seed: int) -> FloorPlan:
    """Returns the floor plan of a scene without writing it: the first of a few in which the robot reaches every room.

    Raises:
        WorldError: the seed has no such plan; another seed has one.
    """
    for draw in range(scene.first_draw, scene.first_draw + _DRAWS):
        numbers = [seed, zlib.crc32(scene.name.encode()), *([draw] if draw else [])]
        plan = FloorPlan(seed, np.random.default_rng(numbers))
        scene.lay_out(plan)
        cut_off = cut_off_rooms(plan)
        if not cut_off:
            return plan
    raise WorldError(f"furniture blocks the way to a {cut_off[0]} in {_DRAWS} plans; use another seed")
