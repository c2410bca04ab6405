"""Content of an imported scene, for every file format: parts with their appearance, names and labels.

Data only. Does not read files.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from schemas.support.numpy_types import Floats

Colour = tuple[float, float, float]
Affine = tuple[float, float, float, float, float, float]

GRAY: Colour = (0.18, 0.18, 0.18)
"""Linear default colour, equal to the default of the preview surface."""

BLEND_NOTE = "its texture is blended by alpha, which is not supported; drawn solid in colour, depth and ids"


@dataclass(frozen=True)
class Cutout:
    """Holes that a texture cuts into a surface: its points below a threshold are not drawn."""

    threshold: float
    """Least opacity that is drawn, 0..1."""
    image: str
    """Resolved path of the texture with the opacity; it has the coordinates of the base colour texture."""
    channel: str = "a"
    """Channel of the opacity: `r`, `g`, `b` or `a`; red is used for `a` if the image has no alpha."""
    is_plain: bool = False
    """Whether the base colour is uniform, and only the opacity has a texture."""


@dataclass(frozen=True)
class Surface:
    """Appearance of one material."""

    colour: Colour = GRAY
    """Linear base colour; with a texture, its factor."""
    texture: str = ""
    """Resolved path of the base colour texture, or an empty string."""
    fallback: Colour = GRAY
    """Linear colour used if the texture cannot be read."""
    uv_set: str = "st"
    uv_affine: Affine | None = None
    """Rows (a, b, c), (d, e, f) with u' = a u + b v + c and v' = d u + e v + f; `None` for the identity."""
    opacity: float = 1.0
    emits: bool = False
    """Whether the material is emissive."""
    emission: Colour = (0.0, 0.0, 0.0)
    """Linear emission colour, if it is uniform."""
    name: str = ""
    """Name of the material, whose words may name its substance."""
    is_metal: bool = False
    """Whether the material is authored as a metal."""
    cutout: Cutout | None = None
    """Holes of the texture, if it cuts some."""

    @property
    def picture(self) -> str:
        """Name of the picture of the surface: its texture with its holes; empty without texture."""
        cut = self.cutout
        if cut is None or not self.texture:
            return self.texture
        return "\n".join((self.texture, cut.image, cut.channel, f"{cut.threshold:.6f}", str(cut.is_plain)))

    @property
    def images(self) -> frozenset[str]:
        """Paths of the textures of the surface."""
        return frozenset({self.texture, self.cutout.image if self.cutout else ""} - {""})


@dataclass(frozen=True)
class Part:
    """Triangles of one prim with one material, in world coordinates."""

    path: str
    """Path of the prim, unique per instance."""
    triangles: Floats
    """(T, 3, 3) corners, world metres, z up, counter-clockwise from outside."""
    uvs: Floats | None
    """(T, 3, 2) texture coordinates, v = 0 at the bottom."""
    tints: Floats | None
    """(T, 3, 3) linear vertex colours, if the prim has them."""
    surface: Surface
    is_collider: bool = False
    """Whether the part is authored for collision only and is not visible."""


class TextureRecipe(NamedTuple):
    """Texture of an authored scene, which is drawn; equal values give equal pixels."""

    name: str
    """Name of the texture."""


@dataclass(frozen=True)
class Extraction:
    """Content of a stage, in the order of its prims."""

    # the readers of all formats return it; USD cannot be the common form, because images in a GLB file have no path

    parts: tuple[Part, ...]
    metres_per_unit: float
    labels: dict[str, str]
    """Prim path -> authored semantic label."""
    groups: frozenset[str]
    """Paths of grouping prims: scopes and prims of kind group or assembly."""
    models: frozenset[str]
    """Paths of prims that are one object: instances, copies and prims of kind component."""
    components: frozenset[str]
    """Paths of prims of kind component; their descendants are not separate objects."""
    sha256: str
    """SHA-256 of the layers and textures of the stage."""
    files_sha256: str
    """SHA-256 of the layers and textures and of their paths relative to the root layer."""
    notes: tuple[str, ...]
    floor_m: float | None = None
    """Height of a floor to add, metres."""
    ceiling_m: float | None = None
    """Height above the floor of a ceiling to add, metres."""
    articulated: frozenset[str] = frozenset()
    """Paths of objects with movable parts, such as drawers. Parts of the category of their object are not targets."""
    images: Mapping[str, bytes | TextureRecipe] = field(default_factory=dict)
    """Encoded images that are part of another file, and textures to draw, by their name in `Surface.texture`."""
