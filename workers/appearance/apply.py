"""Applies the drawn appearance of an episode to its compiled scene: light, materials and clutter. Pure functions.

Geometry, instance ids and the order of the parts are unchanged; clutter is added at the end. The result is a compiled
scene that every renderer and ray caster takes.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from schemas.appearance import ClutterObject, DrawnAppearance, SurfaceChange
from schemas.appearance.light_groups import LightGroups
from schemas.errors import WorldError
from schemas.scene import MAX_INSTANCES, MAX_TEXTURES, CompiledScene, Instance, SceneInfo
from schemas.support.numpy_types import Floats
from workers.appearance.clutter import RADII, SHADOW_RINGS, shape_of
from workers.appearance.floor import FloorTriangle, FloorUnder
from workers.appearance.materials import planar_uvs
from workers.appearance.patterns import draw_pattern
from workers.appearance.relight import SKY_K, Rgb, expose, expose_sky, gain_of, mix_light
from workers.appearance.surfaces import as_slot, find_slots, rgb_of

_LIFT_M = 0.002
"""Height of a shadow above the floor, metres."""
_RING_STEPS = 24
_FULL = 255


def apply_appearance(scene: CompiledScene, light: LightGroups | None, drawn: DrawnAppearance) -> CompiledScene:
    """Returns the scene with the appearance of an episode.

    Args:
        scene: compiled scene.
        light: its light groups; needed if the light is varied.
        drawn: factors of the episode.

    Raises:
        WorldError: the factors are of another scene, or light groups are missing.
    """
    changed = _repaint(scene, drawn.materials)
    if drawn.clutter:
        changed = _with_clutter(changed, drawn.clutter)
    return _relight(changed, light, drawn)


def clutter_instances(scene_ids: list[int], clutter: tuple[ClutterObject, ...]) -> tuple[Instance, ...]:
    """Returns the instances of the clutter; their ids follow the largest instance id of the scene.

    Raises:
        WorldError: no ids are left.
    """
    first = max(scene_ids, default=0) + 1
    if first + len(clutter) - 1 > MAX_INSTANCES:
        raise WorldError(f"the scene has no ids left for {len(clutter)} small objects: remove `clutter`")
    return tuple(
        Instance(id=first + number, prim_path=f"/Clutter/{thing.kind}_{number + 1:02d}")
        for number, thing in enumerate(clutter)
    )


def _relight(scene: CompiledScene, light: LightGroups | None, drawn: DrawnAppearance) -> CompiledScene:
    stops = 0.0 if drawn.camera is None else drawn.camera.exposure_stops
    if drawn.light is None:
        if stops == 0:
            return scene
        lit = _with_light_map(scene)
        return replace(lit, info=_with_sky(scene.info, (2.0**stops,) * 3), light_map=expose(lit.light_map, stops))
    name, wanted = scene.info.name, len(drawn.light.lamps)
    if light is None:
        raise WorldError(f"scene {name} has no light groups, but its light is varied: run `factory scene light {name}`")
    if len(light.info.groups) != wanted:
        problem = f"scene {name} has {len(light.info.groups)} light groups, the appearance has {wanted}"
        raise WorldError(f"{problem}: the appearance is of another scene")
    red, green, blue = gain_of(drawn.light.sky, SKY_K)
    info = _with_sky(scene.info, (red * 2**stops, green * 2**stops, blue * 2**stops))
    lit = _with_light_map(scene)
    shares = light.shares if scene.light_map.size else np.full((1, 1, 1), _FULL, np.uint8)
    return replace(lit, info=info, light_map=mix_light(lit.light_map, shares, drawn.light, stops))


def _with_sky(info: SceneInfo, gain: Rgb) -> SceneInfo:
    return info if info.sky is None else info.model_copy(update={"sky": expose_sky(info.sky, gain)})


def _with_light_map(scene: CompiledScene) -> CompiledScene:
    """Returns the scene with a light map of one texel if it has none."""
    if scene.light_map.size:
        return scene
    return replace(
        scene,
        light_map=np.full((1, 1, 3), _FULL, np.uint8),
        light_uvs=np.zeros((len(scene.positions), 2), np.float32),
    )


def _repaint(scene: CompiledScene, changes: tuple[SurfaceChange, ...]) -> CompiledScene:
    if not changes:
        return scene
    slots, of_vertex = find_slots(scene)
    numbers = {slot: number for number, slot in enumerate(slots)}
    patterns = sorted({change.texture for change in changes if change.texture is not None})
    colours, uvs, layers = scene.colours.copy(), scene.uvs.copy(), scene.part_texture.copy()
    to_colour = np.zeros((len(slots), 3), np.uint8)
    is_changed = np.zeros(len(slots), bool)
    layer_of, tile_of = np.full(len(slots), -1, np.int64), np.ones(len(slots))
    for change in changes:
        slot = as_slot(change)
        if slot not in numbers:
            raise WorldError(
                f"scene {scene.info.name} has no surface {tuple(slot)}: the appearance is of another scene"
            )
        number = numbers[slot]
        to_colour[number], is_changed[number] = rgb_of(change.to_colour), True
        if change.texture is not None:
            layer_of[number], tile_of[number] = len(scene.textures) + patterns.index(change.texture), change.tile_m
    rows = np.flatnonzero((of_vertex >= 0) & is_changed[of_vertex])
    colours[rows] = to_colour[of_vertex[rows]]
    for part, (first, count) in enumerate(zip(scene.part_first.tolist(), scene.part_count.tolist(), strict=True)):
        corner_colours = of_vertex[first : first + count]
        chosen = corner_colours[corner_colours >= 0]
        if len(chosen) and layer_of[chosen].max() >= 0 and layers[part] not in scene.masks:
            number = chosen[np.argmax(layer_of[chosen])]
            layers[part] = layer_of[number]
            uvs[first : first + count] = planar_uvs(scene.positions[first : first + count], float(tile_of[number]))
    textures = (*scene.textures, *map(draw_pattern, patterns))
    if len(textures) > MAX_TEXTURES:
        raise WorldError(
            f"scene {scene.info.name} has {len(scene.textures)} of at most {MAX_TEXTURES} textures, and "
            f"{len(patterns)} patterns of walls and floors do not fit: set materials.walls and materials.floors to []"
        )
    info = scene.info.model_copy(update={"texture_count": len(textures)})
    return replace(scene, info=info, colours=colours, uvs=uvs, part_texture=layers, textures=textures)


def _with_clutter(scene: CompiledScene, clutter: tuple[ClutterObject, ...]) -> CompiledScene:
    floor = FloorUnder(scene)
    instances = clutter_instances([item.id for item in scene.info.instances], clutter)
    pieces = []
    for thing, instance in zip(clutter, instances, strict=True):
        beneath = floor.triangle_at(thing.x_m, thing.y_m)
        if beneath is None:
            raise WorldError(f"scene {scene.info.name} has no floor at ({thing.x_m:g}, {thing.y_m:g}) m")
        pieces += [_shadow(scene, thing, beneath), _body(scene, thing, beneath, instance.id)]
    vertices: dict[str, Any] = {
        name: np.concatenate([getattr(scene, name), *(piece[name] for piece in pieces)])
        for name in ("positions", "uvs", "colours", "light_uvs")
    }
    counts = np.array([len(piece["positions"]) for piece in pieces], np.int32)
    firsts = len(scene.positions) + np.cumsum(counts) - counts
    info = scene.info.model_copy(update={"instances": (*scene.info.instances, *instances)})
    return replace(
        scene,
        info=info,
        **vertices,
        part_first=np.concatenate((scene.part_first, firsts.astype(np.int32))),
        part_count=np.concatenate((scene.part_count, counts)),
        part_instance=np.concatenate((scene.part_instance, [piece["instance"] for piece in pieces])).astype(np.uint16),
        part_texture=np.concatenate((scene.part_texture, [piece["texture"] for piece in pieces])).astype(np.int16),
    )


def _body(scene: CompiledScene, thing: ClutterObject, beneath: FloorTriangle, instance: int) -> dict[str, Any]:
    """Returns the part of a clutter object; all of its vertices have the light of the floor beneath its centre."""
    shape = shape_of(thing.kind)
    cos, sin = math.cos(math.radians(thing.yaw_deg)), math.sin(math.radians(thing.yaw_deg))
    x, y, z = np.moveaxis(shape.triangles.reshape(-1, 3) * thing.size_m, 1, 0)
    height = float(beneath.corners[:, 2].max())
    placed = np.column_stack((thing.x_m + cos * x - sin * y, thing.y_m + sin * x + cos * y, z + height + _LIFT_M))
    colours = np.clip(np.repeat(shape.shades, 3, axis=0) * rgb_of(thing.colour), 0, _FULL)
    centre = np.tile(((thing.x_m, thing.y_m),), (len(placed), 1))
    return _piece(scene, placed, np.rint(colours), beneath, centre, instance, -1)


def _shadow(scene: CompiledScene, thing: ClutterObject, beneath: FloorTriangle) -> dict[str, Any]:
    """Returns the shadow of a clutter object: rings around its base that are darker towards its centre.

    The rings have the colour, texture and instance id of the floor.
    """
    radius = RADII[thing.kind] * thing.size_m
    turns = [2 * math.pi * k / _RING_STEPS for k in range(_RING_STEPS + 1)]
    ring = np.array([(math.cos(turn), math.sin(turn)) for turn in turns])
    corners, shades = [], []
    for low, high, shade in SHADOW_RINGS:
        inner, outer = (np.array((thing.x_m, thing.y_m)) + radius * share * ring for share in (low, high))
        for k in range(_RING_STEPS):
            quads = [(inner[k], outer[k], outer[k + 1]), (inner[k], outer[k + 1], inner[k + 1])]
            corners += quads[:1] if low == 0 else quads
            shades += [shade] * (1 if low == 0 else 2)
    flat = np.array(corners).reshape(-1, 2)
    placed = np.column_stack((flat, np.full(len(flat), float(beneath.corners[:, 2].max()) + _LIFT_M)))
    colour = scene.colours[beneath.first].astype(np.float64)
    colours = np.rint(np.repeat(np.array(shades), 3)[:, None] * colour)
    instance, texture = int(scene.part_instance[beneath.part]), int(scene.part_texture[beneath.part])
    return _piece(scene, placed, colours, beneath, flat, instance, texture)


def _piece(
    scene: CompiledScene,
    placed: Floats,
    colours: Floats,
    beneath: FloorTriangle,
    lit_at: Floats,
    instance: int,
    texture: int,
) -> dict[str, Any]:
    """Returns the arrays of a part whose vertices are at `placed` (V, 3).

    Its texture coordinates are those of the floor below the vertices. Its light coordinates are those of the floor at
    the points `lit_at` (V, 2).
    """
    light_uvs = np.zeros((0, 2), np.float32)
    if len(scene.light_uvs):
        light_uvs = beneath.values_at(scene.light_uvs, lit_at).clip(0, 1).astype(np.float32)
    uvs = beneath.values_at(scene.uvs, placed[:, :2]).astype(np.float32)
    return {
        "positions": placed.astype(np.float32),
        "uvs": uvs if texture >= 0 else np.zeros_like(uvs),
        "colours": colours.astype(np.uint8),
        "light_uvs": light_uvs,
        "instance": instance,
        "texture": texture,
    }
