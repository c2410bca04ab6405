"""Compiled scenes: models, arrays, and the package that a worker simulates and renders.

Does not compile scenes; `factory.scenes` does.
"""

from schemas.scene.compiled import DRAWN, SCENE_ARRAYS, CompiledScene, Layer
from schemas.scene.files import read_complete, read_geometry, read_info, read_scene
from schemas.scene.info import (
    CUTOUT_FORMAT,
    LAYOUT_FORMAT,
    MAX_INSTANCES,
    MAX_LIGHT_MAP_PX,
    MAX_TEXTURES,
    SCENE_FORMAT,
    TEXTURE_SIZE_PX,
    Footprint,
    Instance,
    SceneInfo,
    Sky,
    Target,
    TextureFile,
)
from schemas.scene.package import (
    decode_geometry,
    decode_scene,
    encode_layout,
    encode_scene,
    read_scene_info,
    read_survey,
)

__all__ = [
    "CUTOUT_FORMAT",
    "DRAWN",
    "LAYOUT_FORMAT",
    "MAX_INSTANCES",
    "MAX_LIGHT_MAP_PX",
    "MAX_TEXTURES",
    "SCENE_ARRAYS",
    "SCENE_FORMAT",
    "TEXTURE_SIZE_PX",
    "CompiledScene",
    "Footprint",
    "Instance",
    "Layer",
    "SceneInfo",
    "Sky",
    "Target",
    "TextureFile",
    "decode_geometry",
    "decode_scene",
    "encode_layout",
    "encode_scene",
    "read_complete",
    "read_geometry",
    "read_info",
    "read_scene",
    "read_scene_info",
    "read_survey",
]
