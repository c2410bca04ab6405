"""Arrays of a compiled scene, their specs, and the conditions that they fulfil together. Encodes nothing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from schemas.encoding.arrays import ArraySpec
from schemas.errors import InvalidBundle
from schemas.scene.info import MAX_LIGHT_MAP_PX, TEXTURE_SIZE_PX, SceneInfo

Layer = NDArray[np.uint8]
"""(512, 512, 3) pixels of a texture, sRGB, top row first."""


@dataclass(frozen=True)
class CompiledScene:
    """Scene ready for simulation: world frame in metres, z up, floor at `info.floor_height_m`.

    Triangles do not share vertices: every three consecutive rows of `positions` are one triangle, counter-clockwise
    seen from outside. A part is a range of triangles with one instance and one texture; parts are the unit of culling.
    """

    info: SceneInfo
    """Metadata of the scene."""
    positions: NDArray[np.float32]
    """(V, 3) vertex positions, metres."""
    uvs: NDArray[np.float32]
    """(V, 2) texture coordinates, repeating; v = 0 is the bottom row of the texture."""
    colours: NDArray[np.uint8]
    """(V, 3) vertex colours, sRGB; they multiply the texture."""
    light_uvs: NDArray[np.float32]
    """(V, 2) coordinates in the light map, 0..1; (0, 2) in a scene without light map."""
    light_map: NDArray[np.uint8]
    """(H, W, 3) baked light, gamma-encoded like sRGB, 255 is full light; it multiplies the colours; v = 0 is the edge
    of row 0. (0, 0, 3) in a scene without light map, which is rendered at full brightness."""
    part_first: NDArray[np.int32]
    """(P,) first vertex of each part."""
    part_count: NDArray[np.int32]
    """(P,) number of vertices of each part."""
    part_instance: NDArray[np.uint16]
    """(P,) instance id of each part."""
    part_texture: NDArray[np.int16]
    """(P,) layer in `textures` of each part, or -1 for a part without texture."""
    textures: tuple[Layer, ...]
    """Texture layers, each (512, 512, 3), sRGB, top row first; empty if the scene was read without its pixels."""
    collider_vertices: NDArray[np.float32]
    """(M, 3) vertices of all solid objects except the floor, metres."""
    collider_triangles: NDArray[np.int32]
    """(K, 3) indices into `collider_vertices`."""
    occupancy: NDArray[np.uint8]
    """(H, W) 0 free, 1 occupied in the robot's height band, 2 occupied and blocking the line of sight; rows are y."""
    reachable: NDArray[np.uint8]
    """(H, W) 1 on the connected floor on which the robot's body fits."""
    spawns: NDArray[np.float32]
    """(S, 2) surveyed floor points x, y at which base_link fits with at least one heading, metres."""
    spawn_sees: NDArray[np.uint8]
    """(S, targets) 1 where the straight line from the spawn to the target's success circle is free."""
    masks: Mapping[int, NDArray[np.uint8]] = field(default_factory=dict)
    """Masks (512, 512) of the texture layers that cut holes, by layer, top row first: a point with a value of at least
    `DRAWN` is drawn, the others are holes in colour, depth and ids. Empty without such layers, or without textures."""

    @property
    def part_is_cut(self) -> NDArray[np.bool_]:
        """(P,) whether the texture of each part cuts holes."""
        return np.isin(self.part_texture, list(self.masks))


DRAWN = 128
"""Least value of a mask at which a surface is drawn."""


SCENE_ARRAYS = {
    spec.name: spec
    for spec in (
        ArraySpec("positions", (None, 3), dtype=np.float32, unit="m", low=-1e4, high=1e4),
        ArraySpec("uvs", (None, 2), np.float32, "1"),
        ArraySpec("colours", (None, 3), np.uint8, "sRGB"),
        ArraySpec("light_uvs", (None, 2), dtype=np.float32, unit="1", low=0, high=1),
        ArraySpec("light_map", (None, None, 3), np.uint8, "gamma 1/2.2"),
        ArraySpec("part_first", (None,), dtype=np.int32, unit="vertex", low=0),
        ArraySpec("part_count", (None,), dtype=np.int32, unit="vertices", low=0),
        ArraySpec("part_instance", (None,), dtype=np.uint16, unit="instance id", low=1),
        ArraySpec("part_texture", (None,), dtype=np.int16, unit="layer", low=-1, high=63),
        ArraySpec("collider_vertices", (None, 3), dtype=np.float32, unit="m", low=-1e4, high=1e4),
        ArraySpec("collider_triangles", (None, 3), dtype=np.int32, unit="vertex", low=0),
        ArraySpec("occupancy", (None, None), dtype=np.uint8, unit="1", low=0, high=2),
        ArraySpec("reachable", (None, None), dtype=np.uint8, unit="1", low=0, high=1),
        ArraySpec("spawns", (None, 2), dtype=np.float32, unit="m", low=-1e4, high=1e4),
        ArraySpec("spawn_sees", (None, None), dtype=np.uint8, unit="1", low=0, high=1),
    )
}
"""Specs of the arrays of a scene except its textures, by name."""
MASK_LAYERS_SPEC = ArraySpec("mask_layers", (None,), dtype=np.int16, unit="layer", low=0, high=63)
MASKS_SPEC = ArraySpec("masks", (None, TEXTURE_SIZE_PX, TEXTURE_SIZE_PX), np.uint8, "1")
"""Specs of the members of a package of format 5 that contain `CompiledScene.masks`."""
TEXTURES_SPEC = ArraySpec("textures", (None, TEXTURE_SIZE_PX, TEXTURE_SIZE_PX, 3), np.uint8, "sRGB")
"""Spec of the member of a package of format 3 that contains all texture layers."""


def contradictions(scene: CompiledScene) -> list[str]:
    """Returns the conditions between arrays that a scene does not fulfil, one line each."""
    vertices = len(scene.positions)
    checks = {
        "uvs and colours have one row per vertex": len(scene.uvs) == len(scene.colours) == vertices,
        "light_uvs has one row per vertex if there is a light map, else none": len(scene.light_uvs)
        == (vertices if scene.light_map.size else 0),
        f"light map is at most {MAX_LIGHT_MAP_PX} texels a side": max(scene.light_map.shape[:2]) <= MAX_LIGHT_MAP_PX,
        "part_* have equal lengths": len({len(scene.part_first), len(scene.part_count), len(scene.part_instance)}) == 1
        and len(scene.part_texture) == len(scene.part_first),
        "parts are within the vertices": bool((scene.part_first.astype(np.int64) + scene.part_count <= vertices).all()),
        "parts refer to existing texture layers": bool((scene.part_texture < scene.info.texture_count).all()),
        "masks belong to existing texture layers": all(0 <= layer < scene.info.texture_count for layer in scene.masks),
        "texture_count is the number of textures": len(scene.textures) in (0, scene.info.texture_count),
        "collider triangles refer to vertices": bool((scene.collider_triangles < len(scene.collider_vertices)).all()),
        "all grids have the same shape": scene.occupancy.shape == scene.reachable.shape,
        "spawn_sees has one row per spawn and one column per target": scene.spawn_sees.shape
        == (len(scene.spawns), len(scene.info.targets)),
    }
    return [f"condition not met: {claim}" for claim, holds in checks.items() if not holds]


def require_valid(scene: CompiledScene) -> None:
    """Checks the arrays of a scene as the readers of its package do; textures are not checked.

    Raises:
        InvalidBundle: an array violates its spec, or contradicts another.
    """
    findings = [fault for name, spec in SCENE_ARRAYS.items() for fault in spec.violations(getattr(scene, name))]
    if findings or (findings := contradictions(scene)):
        raise InvalidBundle("scene refused", findings)
