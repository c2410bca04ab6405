"""A compiled scene as binary glTF 2.0, for simulators that make their own pictures. Pure; writes only.

Axes are glTF's and Habitat's: x right, y up, z backward. Colours and textures, unlit; the baked light stays out, as
glTF has no light maps.
"""

from __future__ import annotations

import io
import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from schemas.scene import CompiledScene

__all__ = ["encode_glb"]

_FLOAT, _USHORT = 5126, 5123
_ARRAY_BUFFER = 34962
_UNLIT = "KHR_materials_unlit"
_JSON_CHUNK, _BINARY_CHUNK = 0x4E4F534A, 0x004E4942


def encode_glb(scene: CompiledScene) -> bytes:
    """Returns the visible triangles of a scene: one mesh, a primitive for each texture and one for plain colours."""
    binary = _Binary()
    materials: list[dict[str, Any]] = []
    textures: list[dict[str, int]] = []
    primitives: list[dict[str, Any]] = []
    for layer in np.unique(scene.part_texture).tolist():
        material: dict[str, Any] = {
            "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0},
            "extensions": {_UNLIT: {}},
        }
        if layer >= 0:
            material["pbrMetallicRoughness"]["baseColorTexture"] = {"index": len(textures)}
            textures.append({"sampler": 0, "source": len(textures)})
            binary.add_image(scene.textures[layer])
        attributes = _attributes(binary, scene, _vertices_of(scene, layer), layer >= 0)
        primitives.append({"attributes": attributes, "material": len(materials)})
        materials.append(material)
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "minivla-factory"},
        "extensionsUsed": [_UNLIT],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": scene.info.name}],
        "meshes": [{"primitives": primitives}],
        "materials": materials,
        "accessors": binary.accessors,
        "bufferViews": binary.views,
        "buffers": [{"byteLength": len(binary.data)}],
    }
    if textures:
        document |= {"textures": textures, "images": binary.images, "samplers": [{"wrapS": 10497, "wrapT": 10497}]}
    return _pack(document, bytes(binary.data))


class _Binary:
    """The one buffer, and what describes its parts."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self.images: list[dict[str, Any]] = []

    def add_array(self, array: NDArray[Any], kind: str, component: int, **more: Any) -> int:
        """Appends an attribute of vertices and returns the number of its accessor."""
        view = self._add(np.ascontiguousarray(array).tobytes(), target=_ARRAY_BUFFER)
        accessor = {"bufferView": view, "componentType": component, "count": len(array), "type": kind, **more}
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def add_image(self, pixels: NDArray[np.uint8]) -> None:
        """Appends a texture as PNG."""
        buffer = io.BytesIO()
        Image.fromarray(pixels).save(buffer, "PNG", compress_level=6)
        self.images.append({"bufferView": self._add(buffer.getvalue()), "mimeType": "image/png"})

    def _add(self, data: bytes, **more: Any) -> int:
        self.data += b"\0" * (-len(self.data) % 4)
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), **more})
        self.data += data
        return len(self.views) - 1


def _vertices_of(scene: CompiledScene, layer: int) -> NDArray[np.int64]:
    parts = np.flatnonzero(scene.part_texture == layer)
    runs = [np.arange(scene.part_first[part], scene.part_first[part] + scene.part_count[part]) for part in parts]
    return np.concatenate(runs).astype(np.int64)


def _attributes(
    binary: _Binary, scene: CompiledScene, vertices: NDArray[np.int64], is_textured: bool
) -> dict[str, int]:
    x, y, z = scene.positions[vertices].T
    positions = np.column_stack([x, z, -y]).astype("<f4")
    low, high = positions.min(axis=0).tolist(), positions.max(axis=0).tolist()
    attributes = {"POSITION": binary.add_array(positions, "VEC3", _FLOAT, min=low, max=high)}
    if is_textured:
        u, v = scene.uvs[vertices].T
        uvs = np.column_stack([u, 1 - v]).astype("<f4")  # glTF counts v from the top row
        attributes["TEXCOORD_0"] = binary.add_array(uvs, "VEC2", _FLOAT)
    colours = np.full((len(vertices), 4), 65535, "<u2")  # four components, for the alignment that glTF demands
    colours[:, :3] = np.rint(_linear(scene.colours[vertices]) * 65535)
    attributes["COLOR_0"] = binary.add_array(colours, "VEC4", _USHORT, normalized=True)
    return attributes


def _linear(colours: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Returns sRGB as linear 0..1; vertex colours of glTF are linear, its textures are not."""
    values = colours / 255.0
    curve: NDArray[np.float64] = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    return curve


def _pack(document: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    size = 12 + 8 + len(text) + 8 + len(binary)
    head = struct.pack("<4sII", b"glTF", 2, size)
    chunks = struct.pack("<II", len(text), _JSON_CHUNK) + text + struct.pack("<II", len(binary), _BINARY_CHUNK) + binary
    return head + chunks
