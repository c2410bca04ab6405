"""Encodes a compiled scene as binary glTF 2.0 for simulators that render it. Only this module imports `trimesh`.

Axes are those of glTF and Habitat: x right, y up, z backward. Contains unlit colours and textures, without the baked
light, because glTF has no light maps.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from schemas.scene import CompiledScene

__all__ = ["encode_glb"]

_UNLIT = "KHR_materials_unlit"
_COLOUR = "COLOR_0"


def encode_glb(scene: CompiledScene) -> bytes:
    """Returns the visible triangles of a scene as .glb: one mesh per texture and one for plain colours."""
    from trimesh import Scene
    from trimesh.exchange.gltf import export_glb

    content = Scene(base_frame=scene.info.name)
    for layer in np.unique(scene.part_texture).tolist():
        name = f"texture_{layer}" if layer >= 0 else "colours"
        content.add_geometry(_mesh_of(scene, layer, name), node_name=name, geom_name=name)
    data: bytes = export_glb(content, include_normals=False, tree_postprocessor=_complete)
    return data


def _mesh_of(scene: CompiledScene, layer: int, name: str) -> Any:
    from trimesh import Trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    vertices = _vertices_of(scene, layer)
    x, y, z = scene.positions[vertices].T
    texture = Image.fromarray(scene.textures[layer]) if layer >= 0 else None
    material = PBRMaterial(name=name, metallicFactor=0.0, roughnessFactor=1.0, baseColorTexture=texture)
    return Trimesh(
        np.column_stack([x, z, -y]),
        np.arange(len(vertices)).reshape(-1, 3),
        visual=TextureVisuals(scene.uvs[vertices] if layer >= 0 else None, material),
        vertex_attributes={_COLOUR: _colours_of(scene, vertices)},
        process=False,
    )


def _complete(tree: dict[str, Any]) -> None:
    """Adds unlit materials and 16-bit vertex colours, which trimesh does not write.

    trimesh writes the attribute `COLOR_0` as application-specific, with an underscore and not normalized.
    """
    tree["extensionsUsed"] = [_UNLIT]
    for material in tree["materials"]:
        material["extensions"] = {_UNLIT: {}}
    for mesh in tree["meshes"]:
        attributes = mesh["primitives"][0]["attributes"]
        attributes[_COLOUR] = attributes.pop(f"_{_COLOUR}")
        tree["accessors"][attributes[_COLOUR]]["normalized"] = True


def _vertices_of(scene: CompiledScene, layer: int) -> NDArray[np.int64]:
    parts = np.flatnonzero(scene.part_texture == layer)
    runs = [np.arange(scene.part_first[part], scene.part_first[part] + scene.part_count[part]) for part in parts]
    return np.concatenate(runs).astype(np.int64)


def _colours_of(scene: CompiledScene, vertices: NDArray[np.int64]) -> NDArray[np.uint16]:
    colours = np.full((len(vertices), 4), 65535, np.uint16)
    colours[:, :3] = np.rint(_linear(scene.colours[vertices]) * 65535)
    return colours


def _linear(colours: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Converts sRGB to linear 0..1; glTF vertex colours are linear, glTF textures are sRGB."""
    values = colours / 255.0
    curve: NDArray[np.float64] = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    return curve
