"""Describes a compiled scene as plain data: categories, targets, units, extents, floor, notes.

Pure functions. Does not validate the scene and reads no file.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

from schemas.scene import CompiledScene, SceneInfo, Target


def describe_scene(scene: CompiledScene) -> dict[str, Any]:
    """Returns the description of a scene as JSON-compatible data, lengths in metres."""
    info = scene.info
    (west, south, bottom), (east, north, top) = info.bounds_m
    return {
        "name": info.name,
        "source": info.source,
        "source_sha256": info.source_sha256,
        "metres_per_unit": info.metres_per_unit,
        "bounds_m": [list(corner) for corner in info.bounds_m],
        "extents_m": [round(side, 3) for side in (east - west, north - south, top - bottom)],
        "floor_height_m": info.floor_height_m,
        "free_area_m2": info.free_area_m2,
        "spawns": len(scene.spawns),
        "triangles": len(scene.positions) // 3,
        "collider_triangles": len(scene.collider_triangles),
        "textures": info.texture_count,
        "instances": len(info.instances),
        "categories": dict(sorted(Counter(target.category for target in info.targets).items())),
        "targets": [describe_target(target) for target in info.targets],
        "no_target": list_other_things(info),
        "notes": list(info.notes),
    }


def list_other_things(info: SceneInfo) -> list[dict[str, str | None]]:
    """Returns the instances of a scene that are not targets: walls, floor, unreachable and uncategorised objects."""
    targets = {target.instance_id for target in info.targets}
    return [
        {"prim_path": instance.prim_path, "category": instance.category}
        for instance in info.instances
        if instance.id not in targets
    ]


def describe_target(target: Target) -> dict[str, Any]:
    """Returns the description of a target as JSON-compatible data."""
    return {
        "id": target.target_id,
        "category": target.category,
        "colour": target.colour,
        "centroid_m": list(target.centroid_m),
        "size_m": list(target.size_m),
        "straight_tiers": [str(tier) for tier in target.straight_tiers],
        "connected_tiers": [str(tier) for tier in target.connected_tiers],
        "footprint_m": [list(vertex) for vertex in target.footprint_m],
        "surface_straight_tiers": [str(tier) for tier in target.surface_straight_tiers],
        "surface_connected_tiers": [str(tier) for tier in target.surface_connected_tiers],
        "prim_path": target.prim_path,
    }
