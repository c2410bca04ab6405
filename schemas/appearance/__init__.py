"""Appearance randomisation: ranges of light, materials, camera and clutter, and the factors drawn from them."""

from schemas.appearance.drawn import (
    CameraChange,
    ClutterObject,
    DrawnAppearance,
    LampLight,
    LightMix,
    SurfaceChange,
)
from schemas.appearance.ranges import Appearance, CameraRanges, ClutterRanges, LightRanges, MaterialRanges

__all__ = [
    "Appearance",
    "CameraChange",
    "CameraRanges",
    "ClutterObject",
    "ClutterRanges",
    "DrawnAppearance",
    "LampLight",
    "LightMix",
    "LightRanges",
    "MaterialRanges",
    "SurfaceChange",
]
