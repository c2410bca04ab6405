"""Builds a small room with a baked light map: a lamp under the ceiling, a window, and targets in named colours."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from factory.scenes.light import bake_light
from factory.scenes.light.groups import bake_light_groups
from schemas.appearance.light_groups import LightGroups
from schemas.scene import CompiledScene, Instance
from tests.builders.scene import Box, box_room

SHA256 = "a" * 64
_LAMPS = (
    Box((-2.5, -0.6, 2.3), (-1.5, 0.6, 2.35), (255, 255, 255), solid=False),
    Box((1.5, -0.6, 2.3), (2.5, 0.6, 2.35), (255, 255, 255), solid=False),
    Box((-0.8, 2.96, 1.0), (0.8, 2.99, 2.0), (250, 250, 255), solid=False),
)
_CHAIRS = (
    Box((-1.6, 1.2, 0.0), (-1.1, 1.7, 0.8), (29, 79, 168), category="chair"),
    Box((3.0, -2.0, 0.0), (3.5, -1.5, 0.8), (44, 138, 60), category="chair"),
)


@functools.cache
def lit_room() -> CompiledScene:
    """Returns a room with a baked light map; the prim names of its walls and floor contain `Wall` and `Floor`."""
    scene = box_room((*_CHAIRS, *_LAMPS))
    count = len(scene.part_count)
    brightness = np.repeat(np.arange(count) >= count - len(_LAMPS), 12).astype(np.float64)
    triangles = scene.positions.reshape(-1, 3, 3).astype(np.float64)
    light = bake_light(triangles, np.repeat(np.arange(count), 12), brightness, 0.0)
    names = ["Floor", *("Wall",) * 4]
    instances = tuple(
        Instance(id=item.id, prim_path=f"/World/{names[k] if k < 5 else 'Thing'}_{k}", category=item.category)
        for k, item in enumerate(scene.info.instances)
    )
    info = scene.info.model_copy(update={"instances": instances})
    return replace(scene, info=info, light_uvs=light.uvs.reshape(-1, 2), light_map=light.picture)


@functools.cache
def room_light() -> LightGroups:
    """Returns the light groups of `lit_room`."""
    return bake_light_groups(lit_room(), SHA256)
