"""Compiled scenes: models, array specs and codec of the package that a worker simulates and renders.

Does not compile scenes; `factory.scenes` does.
"""

from __future__ import annotations

import functools
import io
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated, BinaryIO

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator

from schemas.base import Count, Finite, Line, Model, Name, NonNegative, Positive, PrimPath, Text
from schemas.encoding.arrays import ArraySpec
from schemas.encoding.container import ContainerLimits, ContainerReader, ContainerWriter
from schemas.encoding.ndarray import decode_npy_zst, encode_npy_zst
from schemas.errors import InvalidBundle
from schemas.terms import SuccessMeasure, Tier

SCENE_FORMAT = 3
"""Version of the compiled package. A reader opens format 2, which has no footprints, and rejects every other one."""
_READABLE = (2, SCENE_FORMAT)
TEXTURE_SIZE_PX = 512
"""Width and height of a texture, pixels."""
MAX_TEXTURES = 64
"""Largest number of textures."""
MAX_LIGHT_MAP_PX = 2048
"""Largest width and height of a light map, pixels."""
MAX_INSTANCES = 65535
"""Largest instance id, which the 16-bit id image limits."""
MAX_SCENE_BYTES = 512 << 20
"""Largest size of a package and of each of its members, bytes."""
_LIMITS = ContainerLimits(members=64, member_bytes=MAX_SCENE_BYTES)

Vector3 = tuple[Finite, Finite, Finite]
Channel = Annotated[int, Field(ge=0, le=255)]
Colour = tuple[Channel, Channel, Channel]
Tiers = Annotated[tuple[Tier, ...], Field(max_length=len(Tier))]
Footprint = Annotated[tuple[tuple[Finite, Finite], ...], Field(max_length=64)]
"""Vertices x, y of a convex polygon in the world frame, counter-clockwise, metres."""


class Instance(Model):
    """Object that the id image can show."""

    id: Annotated[int, Field(ge=1, le=MAX_INSTANCES)]
    """Value of its pixels in `seg_front`."""
    prim_path: PrimPath
    """Path of the USD prim."""
    category: Name | None = None
    """Category of the object, or `None` for walls, floors and clutter."""
    materials: Annotated[tuple[Name, ...], Field(max_length=16)] = Field(default=(), exclude_if=lambda it: not it)
    """Known materials: the one that covers at least 60 % of its surface, then others that are visible; `unknown` stands
    for surfaces without a known one. Empty and omitted if no known one covers that much."""


class Target(Model):
    """Object that an instruction can name and the robot can reach (docs/design/scenes.md#targets)."""

    target_id: Name
    """Stable name within the scene, e.g. `chair_007`."""
    category: Name
    """Category of the target."""
    instance_id: Annotated[int, Field(ge=1, le=MAX_INSTANCES)]
    """Value of its pixels in `seg_front`."""
    prim_path: PrimPath
    """Path of the USD prim."""
    centroid_m: Vector3
    """Centre of the bounding box in the world frame, metres."""
    size_m: Vector3
    """Extent of the bounding box along the world axes, metres."""
    colour: Name = "unknown"
    """Dominant colour name, or `unknown`."""
    straight_tiers: Tiers = ()
    """Tiers that have a start pose with a free straight line to the success circle."""
    connected_tiers: Tiers = ()
    """Tiers that have a start pose from which the success circle is reachable."""
    footprint_m: Footprint = ()
    """Convex hull of the target's projection to the floor; empty in a package of format 2."""
    surface_straight_tiers: Tiers = ()
    """`straight_tiers` by the distance to the footprint; empty in a package of format 2."""
    surface_connected_tiers: Tiers = ()
    """`connected_tiers` by the distance to the footprint; empty in a package of format 2."""

    def tiers(self, success: SuccessMeasure, by_path: bool) -> tuple[Tier, ...]:
        """Returns the tiers that have a start pose.

        Args:
            success: measure of the distance to the target.
            by_path: whether the robot follows a path; otherwise it drives straight.
        """
        if success is SuccessMeasure.SURFACE:
            return self.surface_connected_tiers if by_path else self.surface_straight_tiers
        return self.connected_tiers if by_path else self.straight_tiers

    def is_reachable(self, success: SuccessMeasure) -> bool:
        """Returns whether the robot can reach the target from a start in any tier."""
        return bool(self.tiers(success, by_path=True) or self.tiers(success, by_path=False))

    @property
    def taken_m(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Lower and upper corner x, y of the floor area that the target covers, where no episode starts, metres."""
        (x, y, _), (width, depth, _) = self.centroid_m, self.size_m
        return (x - width / 2, y - depth / 2), (x + width / 2, y + depth / 2)


class Sky(Model):
    """Background of an open scene, where no surface is visible: sRGB 0..255."""

    zenith: Colour = (82, 138, 204)
    """Colour straight up."""
    horizon: Colour = (214, 226, 236)
    """Colour at the height of the camera."""
    ground: Colour = (150, 148, 142)
    """Colour below the horizon, beyond the clip range of the camera."""


class SceneInfo(Model):
    """JSON metadata of a compiled package."""

    format: Count = SCENE_FORMAT
    """Version of the compiled package."""
    name: Name
    """Name of the scene."""
    source: Text
    """Description of the source: `built-in office, seed 0` or the file name of an imported scene."""
    source_sha256: Line
    """Digest of all inputs of the compiler: layers, textures, rules, compiler version."""
    metres_per_unit: Positive
    """Length unit of the source stage, metres; all values in the package are in metres, z up."""
    bounds_m: tuple[Vector3, Vector3]
    """Lower and upper corner of the visible geometry, metres."""
    grid_origin_m: tuple[Finite, Finite]
    """World x, y of the outer corner of grid cell (0, 0), metres."""
    grid_resolution_m: Positive = 0.05
    """Side of a grid cell, metres."""
    targets: Annotated[tuple[Target, ...], Field(max_length=MAX_INSTANCES)]
    """Targets of the scene."""
    instances: Annotated[tuple[Instance, ...], Field(max_length=MAX_INSTANCES)]
    """All objects that the id image can show."""
    texture_count: Annotated[int, Field(ge=0, le=MAX_TEXTURES)] = 0
    """Number of texture layers."""
    floor_height_m: Finite = 0.0
    """z of the floor in the world frame, metres."""
    free_area_m2: NonNegative = 0.0
    """Area of the connected floor that the robot can occupy, square metres."""
    notes: Annotated[tuple[Text, ...], Field(max_length=100_000)] = ()
    """Warnings of the importer about skipped or estimated properties, one line each."""
    sky: Sky | None = None
    """Background of an open scene; `None`, as in a closed scene and an older package, is black."""

    @model_validator(mode="after")
    def _targets_are_instances(self) -> SceneInfo:
        known = {instance.id for instance in self.instances}
        stray = [target.target_id for target in self.targets if target.instance_id not in known]
        if stray:
            raise ValueError(f"targets without an instance: {stray}")
        return self

    @property
    def has_footprints(self) -> bool:
        """Whether the package records the footprints of its targets."""
        return all(target.footprint_m for target in self.targets)

    def target(self, target_id: str) -> Target:
        """Returns the target of that name.

        Raises:
            KeyError: the scene has no target of that name.
        """
        return self._targets_by_id[target_id]

    @functools.cached_property
    def _targets_by_id(self) -> Mapping[str, Target]:
        return {target.target_id: target for target in self.targets}


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
    textures: NDArray[np.uint8]
    """(L, 512, 512, 3) textures, sRGB, top row first."""
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


_T = TEXTURE_SIZE_PX
SCENE_ARRAYS = {
    spec.name: spec
    for spec in (
        ArraySpec("positions", (None, 3), np.float32, "m", -1e4, 1e4),
        ArraySpec("uvs", (None, 2), np.float32, "1"),
        ArraySpec("colours", (None, 3), np.uint8, "sRGB"),
        ArraySpec("light_uvs", (None, 2), np.float32, "1", 0, 1),
        ArraySpec("light_map", (None, None, 3), np.uint8, "gamma 1/2.2"),
        ArraySpec("part_first", (None,), np.int32, "vertex", 0),
        ArraySpec("part_count", (None,), np.int32, "vertices", 0),
        ArraySpec("part_instance", (None,), np.uint16, "instance id", 1),
        ArraySpec("part_texture", (None,), np.int16, "layer", -1, 63),
        ArraySpec("textures", (None, _T, _T, 3), np.uint8, "sRGB"),
        ArraySpec("collider_vertices", (None, 3), np.float32, "m", -1e4, 1e4),
        ArraySpec("collider_triangles", (None, 3), np.int32, "vertex", 0),
        ArraySpec("occupancy", (None, None), np.uint8, "1", 0, 2),
        ArraySpec("reachable", (None, None), np.uint8, "1", 0, 1),
        ArraySpec("spawns", (None, 2), np.float32, "m", -1e4, 1e4),
        ArraySpec("spawn_sees", (None, None), np.uint8, "1", 0, 1),
    )
}
"""Specs of the arrays of a package, by member name."""


def encode_scene(scene: CompiledScene, level: int = 9) -> bytes:
    """Returns the package of a scene; equal scenes give equal bytes with the same compressor.

    Args:
        scene: scene to encode.
        level: compression level of zstandard; level 1 takes a sixth of the time, for a package that is not stored.
    """
    buffer = io.BytesIO()
    with ContainerWriter(buffer) as out:
        unused = {"sky"} if scene.info.sky is None else None  # so that an older package keeps its bytes
        out.add("scene.json", scene.info.model_dump_json(indent=1, exclude=unused).encode())
        for field in fields(scene):
            if field.name != "info":
                out.add(f"{field.name}.npy.zst", encode_npy_zst(getattr(scene, field.name), level=level))
    return buffer.getvalue()


def decode_scene(file: BinaryIO) -> CompiledScene:
    """Decodes a package from a seekable file, and enforces the limit of every size.

    Raises:
        InvalidBundle: the package is damaged or inconsistent, or has another format version.
    """
    reader = ContainerReader(file, _LIMITS)
    info = _read_info(reader)
    arrays = {name: _read_array(reader, spec) for name, spec in SCENE_ARRAYS.items()}
    scene = CompiledScene(info=info, **arrays)  # type: ignore[arg-type]
    findings = _contradictions(scene)
    if findings:
        raise InvalidBundle("scene refused", findings)
    return scene


def read_scene_info(file: BinaryIO) -> SceneInfo:
    """Reads the metadata of a package, without its arrays.

    Raises:
        InvalidBundle: the package is damaged or has another format version.
    """
    return _read_info(ContainerReader(file, _LIMITS))


def read_survey(file: BinaryIO) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Reads `spawns` and `spawn_sees` of a package, without its other arrays.

    Raises:
        InvalidBundle: the package is damaged or has another format version.
    """
    reader = ContainerReader(file, _LIMITS)
    spawns, sees = (_read_array(reader, SCENE_ARRAYS[name]) for name in ("spawns", "spawn_sees"))
    return spawns.astype(np.float32), sees.astype(np.uint8)


def _read_info(reader: ContainerReader) -> SceneInfo:
    try:
        info = SceneInfo.model_validate_json(reader.read("scene.json"))
    except ValidationError as error:
        raise InvalidBundle("scene refused", [f"scene.json: {item['msg']}" for item in error.errors()]) from error
    if info.format not in _READABLE:
        remedy = "create it again with `factory scene build` or `factory scene import`"
        found = f"scene format {info.format}, this software reads {SCENE_FORMAT}; {remedy}"
        raise InvalidBundle("scene refused", [found])
    return info


def _read_array(reader: ContainerReader, spec: ArraySpec) -> NDArray[np.generic]:
    data = reader.read(f"{spec.name}.npy.zst")
    array = decode_npy_zst(spec.name, data, spec.dtype, spec.shape, MAX_SCENE_BYTES)
    findings = spec.violations(array)
    if findings:
        raise InvalidBundle("scene refused", findings)
    return array


def _contradictions(scene: CompiledScene) -> list[str]:
    vertices = len(scene.positions)
    checks = {
        "uvs and colours have one row a vertex": len(scene.uvs) == len(scene.colours) == vertices,
        "light_uvs has one row a vertex with a light map, and none without": len(scene.light_uvs)
        == (vertices if scene.light_map.size else 0),
        f"light map is at most {MAX_LIGHT_MAP_PX} texels a side": max(scene.light_map.shape[:2]) <= MAX_LIGHT_MAP_PX,
        "parts have one row each": len({len(scene.part_first), len(scene.part_count), len(scene.part_instance)}) == 1
        and len(scene.part_texture) == len(scene.part_first),
        "parts are within the vertices": bool((scene.part_first.astype(np.int64) + scene.part_count <= vertices).all()),
        "texture layers exist": bool((scene.part_texture < len(scene.textures)).all()),
        "texture_count is the number of textures": len(scene.textures) == scene.info.texture_count,
        "collider triangles refer to vertices": bool((scene.collider_triangles < len(scene.collider_vertices)).all()),
        "grids have one shape": scene.occupancy.shape == scene.reachable.shape,
        "visibility has one row a spawn and one column a target": scene.spawn_sees.shape
        == (len(scene.spawns), len(scene.info.targets)),
    }
    return [f"not true: {claim}" for claim, holds in checks.items() if not holds]
