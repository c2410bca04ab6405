"""Appearance randomisation: ranges of light, materials, camera and clutter, and the factors drawn from them."""

from schemas.appearance.factors import (
    Appearance,
    CameraChange,
    CameraRanges,
    ClutterObject,
    ClutterRanges,
    DrawnAppearance,
    LampLight,
    LightMix,
    LightRanges,
    MaterialRanges,
    SurfaceChange,
)

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
