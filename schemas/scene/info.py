"""Models of the metadata of a compiled scene: objects, targets, textures. Reads no file."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Annotated

from pydantic import Field, model_validator

from schemas.base import Count, Finite, Line, Model, Name, NonNegative, Positive, PrimPath, Sha256, Text
from schemas.terms import SuccessMeasure, Tier

SCENE_FORMAT = 3
"""Version of a package that contains its textures. A reader also opens format 2, which has no footprints."""
LAYOUT_FORMAT = 4
"""Version of a package whose textures are separate files, which many layouts share."""
CUTOUT_FORMAT = 5
"""Version of a package of format 3 with masks of textures. Former readers refuse it, because they would draw solid."""
TEXTURES = "textures"
"""Folder beside packages with the files of the texture layers that they share."""
TEXTURE_SIZE_PX = 512
"""Width and height of a texture, pixels."""
MAX_TEXTURES = 64
"""Largest number of textures."""
MAX_TEXTURE_BYTES = 1 << 20
"""Largest size of the file of a texture, bytes; its pixels take 768 KiB."""
MAX_LIGHT_MAP_PX = 2048
"""Largest width and height of a light map, pixels."""
MAX_INSTANCES = 65535
"""Largest instance id, which the 16-bit id image limits."""

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
    """Materials of the object: first the known material that covers at least 60 % of its surface, then the others that
    are visible; `unknown` means surfaces of unknown material. Empty and omitted if no known material covers 60 %."""


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
    """As `straight_tiers`, with distances to the footprint; empty in a package of format 2."""
    surface_connected_tiers: Tiers = ()
    """As `connected_tiers`, with distances to the footprint; empty in a package of format 2."""

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


class TextureFile(Model):
    """File of a texture layer, which the packages of a folder share."""

    sha256: Sha256
    """SHA-256 of the file."""
    size: Annotated[int, Field(ge=1, le=MAX_TEXTURE_BYTES)]
    """Size of the file, bytes."""

    @property
    def file(self) -> str:
        """Path of the file relative to the folder of the package; in a complete package, the name of its member."""
        return texture_file(self.sha256)


def texture_file(sha256: str) -> str:
    """Returns the path of the file of a texture layer relative to the folder of the packages that use it."""
    return f"{TEXTURES}/{sha256}.npy.zst"


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
    textures: Annotated[tuple[TextureFile, ...], Field(max_length=MAX_TEXTURES)] = ()
    """Files of the texture layers in their order; empty in a package of format 3, which contains them."""
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

    @model_validator(mode="after")
    def _lists_each_layer(self) -> SceneInfo:
        expected = self.texture_count if self.format == LAYOUT_FORMAT else 0
        if len(self.textures) != expected:
            raise ValueError(
                f"format {self.format} with {self.texture_count} texture layers lists {len(self.textures)} files of "
                f"textures, expected {expected}"
            )
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
