"""Appearance of episodes: the ranges of light, materials, camera and clutter, and the values drawn for one episode.

A missing section is not varied. Draws no values; `workers.appearance` does.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, ConfigDict, Field

from schemas.base import Count, Finite, Fraction, Line, Model, NonNegative, Positive


def _ordered(values: tuple[float, float]) -> tuple[float, float]:
    low, high = values
    if low > high:
        raise ValueError(f"the first value, {low:g}, must not be greater than the second, {high:g}: swap them")
    return values


Gain = Annotated[float, Field(ge=0, le=8)]
Gains = Annotated[tuple[Gain, Gain], AfterValidator(_ordered)]
_Kelvin = Annotated[float, Field(ge=1700, le=15_000)]
Temperatures = Annotated[tuple[_Kelvin, _Kelvin], AfterValidator(_ordered)]
_Shift = Annotated[float, Field(ge=-0.2, le=0.2)]
Shifts = Annotated[tuple[_Shift, _Shift], AfterValidator(_ordered)]
_Turn = Annotated[float, Field(ge=-30, le=30)]
Turns = Annotated[tuple[_Turn, _Turn], AfterValidator(_ordered)]
_Focal = Annotated[float, Field(ge=0.5, le=2)]
_Stops = Annotated[float, Field(ge=-4, le=4)]
_Number = Annotated[int, Field(ge=0, le=64)]
_Side = Annotated[float, Field(ge=0.02, le=0.5)]
MAX_SETS = 64
"""Largest number of entries in a list of materials or kinds."""

WallSet = Literal["paint", "brick", "concrete", "panels", "tiles"]
"""Materials of walls."""
FloorSet = Literal["wood", "tiles", "carpet", "concrete", "linoleum"]
"""Materials of floors."""
ClutterKind = Literal["ball", "bottle", "box", "books", "cone"]
"""Kinds of small objects; none of them is a category of the task."""


class LightRanges(Model):
    """Ranges of the light; factors multiply the light of the compiled scene."""

    model_config = ConfigDict(populate_by_name=True, serialize_by_alias=True)

    lamps: Gains = (0.5, 1.6)
    """Factor of the light of each lamp group that is on."""
    off_share: Fraction = 0.2
    """Probability that a lamp group is off; one group is always on."""
    temperature_k: Temperatures = (2700.0, 6500.0)
    """Colour temperature of each lamp group, kelvin; 4000 K keeps the colour of the compiled scene."""
    sky: Gains = (0.6, 1.4)
    """Factor of the light of the sky and of indirect light."""
    sky_temperature_k: Temperatures = (5000.0, 9000.0)
    """Colour temperature of the sky, kelvin; 6500 K keeps the colour of the compiled scene."""
    adaptation: Annotated[Fraction, Field(alias="adaption")] = 0.7
    """Share of a change of the mean light, in stops, that automatic exposure compensates; serialized as `adaption`."""


class MaterialRanges(Model):
    """Sets from which the colours and textures of surfaces are drawn."""

    walls: Annotated[tuple[WallSet, ...], Field(max_length=MAX_SETS)] = (
        "paint",
        "paint",
        "paint",
        "brick",
        "concrete",
        "panels",
        "tiles",
    )
    """Materials of walls; a material that is listed twice is more probable. An empty list keeps the walls."""
    floors: Annotated[tuple[FloorSet, ...], Field(max_length=MAX_SETS)] = (
        "wood",
        "tiles",
        "carpet",
        "concrete",
        "linoleum",
    )
    """Materials of floors; an empty list keeps the floors."""
    ceilings: bool = True
    """Whether the colour of ceilings varies."""
    furniture: bool = True
    """Whether the colours of other objects vary; each keeps its colour name, so instructions stay true."""


class CameraRanges(Model):
    """Ranges of the mounting pose, lens and exposure; all cameras of a robot change alike."""

    x_m: Shifts = (-0.02, 0.02)
    """Displacement along x of base_link, metres."""
    y_m: Shifts = (-0.02, 0.02)
    """Displacement along y of base_link, metres."""
    z_m: Shifts = (-0.03, 0.03)
    """Displacement along z of base_link, metres; a camera stays 2 cm above the floor."""
    roll_deg: Turns = (-1.5, 1.5)
    """Change of the mount's roll, degrees."""
    pitch_deg: Turns = (-3.0, 3.0)
    """Change of the mount's pitch, degrees."""
    yaw_deg: Turns = (-3.0, 3.0)
    """Change of the mount's yaw, degrees."""
    focal: Annotated[tuple[_Focal, _Focal], AfterValidator(_ordered)] = (0.93, 1.07)
    """Factor of the focal length; 0.93 and 1.07 turn a field of view of 90 degrees into 94 and 86 degrees."""
    exposure_stops: Annotated[tuple[_Stops, _Stops], AfterValidator(_ordered)] = (-0.7, 0.7)
    """Exposure, stops; 1 doubles the light."""


class ClutterRanges(Model):
    """Ranges of small objects on the floor beside the path of the robot."""

    count: Annotated[tuple[_Number, _Number], AfterValidator(_ordered)] = (2, 8)
    """Number of objects; an object for which no free place is found is omitted."""
    size_m: Annotated[tuple[_Side, _Side], AfterValidator(_ordered)] = (0.08, 0.3)
    """Largest side of an object, metres."""
    kinds: Annotated[tuple[ClutterKind, ...], Field(min_length=1, max_length=MAX_SETS)] = (
        "ball",
        "bottle",
        "box",
        "books",
        "cone",
    )
    """Kinds of the objects."""
    clearance_m: NonNegative = 0.15
    """Smallest distance of an object from the footprint of the robot at any pose of the episode, metres."""
    reach_m: Annotated[float, Field(gt=0, le=30)] = 4.0
    """Largest distance of an object from the path of the robot, metres."""


class Appearance(Model):
    """Ranges of the appearance of an episode; a section that is null is not varied."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_-]{0,63}$")] = "own"
    """Name of the appearance."""
    light: LightRanges | None = None
    """Ranges of the light."""
    materials: MaterialRanges | None = None
    """Sets of materials."""
    camera: CameraRanges | None = None
    """Ranges of the camera."""
    clutter: ClutterRanges | None = None
    """Ranges of the clutter."""

    @property
    def changes_scenes(self) -> bool:
        """Whether each episode has a separate scene, because more than the pose and lens of the camera varies."""
        exposes = self.camera is not None and self.camera.exposure_stops != (0.0, 0.0)
        return exposes or any((self.light, self.materials, self.clutter))

    def plain(self) -> dict[str, Any]:
        """Returns the ranges as JSON values; omits values that equal their default."""
        return self.model_dump(mode="json", exclude_unset=False, exclude_defaults=True)


Hex = Annotated[str, Field(pattern=r"^#[0-9a-f]{6}$")]
"""sRGB colour as `#rrggbb`."""


class LampLight(Model):
    """Light of one lamp group, or of the sky."""

    gain: Gain
    """Factor of the light of the group; 0 is off."""
    temperature_k: Positive
    """Colour temperature, kelvin."""


class LightMix(Model):
    """Light of an episode."""

    model_config = ConfigDict(populate_by_name=True, serialize_by_alias=True)

    lamps: Annotated[tuple[LampLight, ...], Field(max_length=64)]
    """Light of each lamp group, in the order of the scene's light groups."""
    sky: LampLight
    """Light of the sky, and indirect light."""
    adaptation: Annotated[Fraction, Field(alias="adaption")]
    """Share of a change of the mean light, in stops, that automatic exposure compensates; serialized as `adaption`."""


class SurfaceChange(Model):
    """New material for all surfaces that have the same kind, the same texture and the same colour."""

    surface: Line
    """Kind of the surface: `wall`, `floor`, `ceiling` or `object`."""
    layer: Annotated[int, Field(ge=-1, le=63)]
    """Texture layer in the compiled scene, or -1."""
    colour: Hex
    """Colour in the compiled scene."""
    to_colour: Hex
    """New colour, which multiplies the texture."""
    texture: Line | None = None
    """New texture; null keeps the texture of the compiled scene."""
    tile_m: Positive = 1.0
    """Length of one repeat of a new texture, metres."""


class CameraChange(Model):
    """Change of the cameras' poses, lenses and exposure that an appearance makes."""

    x_m: Finite = 0.0
    """Displacement along x of base_link, metres."""
    y_m: Finite = 0.0
    """Displacement along y of base_link, metres."""
    z_m: Finite = 0.0
    """Displacement along z of base_link, metres."""
    roll_deg: Finite = 0.0
    """Change of the roll, degrees."""
    pitch_deg: Finite = 0.0
    """Change of the pitch, degrees."""
    yaw_deg: Finite = 0.0
    """Change of the yaw, degrees."""
    focal: Positive = 1.0
    """Factor of the focal length."""
    exposure_stops: Finite = 0.0
    """Exposure, stops."""


class ClutterObject(Model):
    """Small object on the floor."""

    kind: ClutterKind
    """Kind of the object."""
    x_m: Finite
    """x of its centre in the world frame, metres."""
    y_m: Finite
    """y of its centre in the world frame, metres."""
    yaw_deg: Finite
    """Rotation about z, degrees."""
    size_m: Positive
    """Largest side, metres."""
    colour: Hex
    """Colour of the object."""


class DrawnAppearance(Model):
    """Values of all factors of an episode; a factor that is null, or has no item, was not varied."""

    name: Line
    """Name of the appearance."""
    episode: Count
    """Number of the episode."""
    light: LightMix | None = None
    """Light of the episode."""
    materials: Annotated[tuple[SurfaceChange, ...], Field(max_length=4096)] = ()
    """Changed materials."""
    camera: CameraChange | None = None
    """Change of the cameras."""
    clutter: Annotated[tuple[ClutterObject, ...], Field(max_length=64)] = ()
    """Small objects on the floor."""

    @property
    def changes_scene(self) -> bool:
        """Whether light, materials, clutter or exposure vary, not only the pose and lens of the cameras."""
        exposes = self.camera is not None and self.camera.exposure_stops != 0
        return bool(self.light or self.materials or self.clutter) or exposes
