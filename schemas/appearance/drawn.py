"""Appearance of one episode: the values of all factors, as they are drawn, recorded and applied."""

from __future__ import annotations

from typing import Annotated

from pydantic import ConfigDict, Field

from schemas.appearance.ranges import ClutterKind, Gain
from schemas.base import Count, Finite, Fraction, Line, Model, Positive

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
