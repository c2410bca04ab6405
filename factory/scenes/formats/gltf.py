"""Reads glTF 2.0 files (.gltf, .glb): nodes with their transforms, triangles, materials and semantic extras.

Checks every size before it allocates. Skins and animations are read in their rest pose. Lights are counted but not
used; cameras are ignored.
"""

from __future__ import annotations

import base64
import json
import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from math import cos, sin
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from factory.scenes.formats.files import SceneFiles, place_of
from factory.scenes.formats.poses import quaternion_matrix
from factory.scenes.formats.shapes import BROKEN, Content, Names, ShapeNode, label_of, mesh_piece
from factory.scenes.importer.collect import Piece
from factory.scenes.importer.content import BLEND_NOTE, Affine, Colour, Cutout, Surface
from schemas.support.numpy_types import Floats, Ints
from schemas.support.shell import quoted

_JSON, _BIN = 0x4E4F534A, 0x004E4942
_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_DATA_URI = "data:"


@dataclass
class Document:
    """An opened glTF file."""

    files: SceneFiles
    json: dict[str, Any]
    binary: bytes
    _buffers: dict[int, bytes] = field(default_factory=dict)

    def items(self, key: str) -> list[dict[str, Any]]:
        """Returns a top-level list, empty if absent."""
        return list(self.json.get(key) or [])

    def item(self, key: str, index: int) -> dict[str, Any]:
        """Returns an item of a top-level list.

        Raises:
            LookupError: the index is out of range.
        """
        entries = self.items(key)
        if not 0 <= index < len(entries):
            raise LookupError(f"{key}[{index}] is used, but there are {len(entries)} {key}")
        return dict(entries[index])

    def view(self, index: int) -> tuple[memoryview, int]:
        """Returns the bytes of a buffer view, and its stride, bytes; 0 if packed."""
        view = self.item("bufferViews", index)
        if "EXT_meshopt_compression" in (view.get("extensions") or {}):
            raise ValueError(f"meshopt compression is not supported; remove it with: {_rewrite(self, 'copy')}")
        start, size = int(view.get("byteOffset", 0)), int(view["byteLength"])
        data = self._buffer(int(view["buffer"]))
        if not 0 <= start <= start + size <= len(data):
            raise ValueError(f"buffer view {index} ends at byte {start + size} of {len(data)}; the file is truncated")
        return memoryview(data)[start : start + size], int(view.get("byteStride", 0))

    def _buffer(self, index: int) -> bytes:
        if index not in self._buffers:
            uri = self.item("buffers", index).get("uri")
            self._buffers[index] = self.binary if uri is None else self._load(str(uri))
        return self._buffers[index]

    def _load(self, uri: str) -> bytes:
        if not uri.startswith(_DATA_URI):
            return self.files.read(place_of(self.files.root.parent, uri))
        head, _, text = uri.partition(",")
        return base64.b64decode(text) if head.endswith(";base64") else unquote_to_bytes(text)

    def accessor(self, index: int) -> NDArray[Any]:
        """Returns the values (N, width) of an accessor; normalised integers as floats.

        Raises:
            ValueError: its buffer view is too short.
        """
        accessor = self.item("accessors", index)
        kind, width, count = str(_TYPES[accessor["componentType"]]), _WIDTHS[accessor["type"]], int(accessor["count"])
        if "bufferView" in accessor:
            values = self._strided(accessor, kind, width, count)
        else:
            self.files.scene.require_room(f"accessor {index}", count // 3)
            values = np.zeros((count, width), kind)
        if accessor.get("sparse"):
            values = self._sparse(accessor["sparse"], values)
        return _normalised(values) if accessor.get("normalized") else values

    def _strided(self, source: dict[str, Any], kind: str, width: int, count: int) -> NDArray[Any]:
        data, stride = self.view(int(source["bufferView"]))
        item, start = np.dtype(kind).itemsize * width, int(source.get("byteOffset", 0))
        stride = stride or item
        if start < 0 or count < 0 or stride < item or (count and start + stride * (count - 1) + item > len(data)):
            raise ValueError(f"{count} values of {stride} bytes from byte {start} in a view of {len(data)} bytes")
        return np.ndarray((count, width), kind, data, start, (stride, np.dtype(kind).itemsize)).copy()

    def _sparse(self, sparse: dict[str, Any], values: NDArray[Any]) -> NDArray[Any]:
        count, places, new = int(sparse["count"]), sparse["indices"], sparse["values"]
        rows = self._strided(places, _TYPES[places["componentType"]], 1, count).reshape(-1)
        values[rows] = self._strided(new, values.dtype.str, values.shape[1], count)
        return values

    def image(self, index: int) -> str:
        """Returns the path of an image; an image inside the file is added to the images of the import."""
        image = self.item("images", index)
        uri = image.get("uri")
        if uri is not None and not str(uri).startswith(_DATA_URI):
            return str(place_of(self.files.root.parent, str(uri)))
        name = f"{self.files.root.name}[image {index}]"
        data = bytes(self.view(int(image["bufferView"]))[0]) if uri is None else self._load(str(uri))
        self.files.images[name] = data
        return name


def read_document(data: bytes, files: SceneFiles) -> Document:
    """Parses a .gltf or .glb file.

    Raises:
        ValueError: it is not glTF 2.0, or it is truncated.
    """
    text, binary = _chunks(data) if data.startswith(b"glTF") else (data, b"")
    document = json.loads(text)
    version = str(document["asset"]["version"])
    if not version.startswith("2."):
        raise ValueError(f"glTF {version} is not supported, only glTF 2.0; export it again")
    return Document(files, document, binary)


def _chunks(data: bytes) -> tuple[bytes, bytes]:
    """Returns the JSON and the binary chunk of a GLB file."""
    if len(data) < 12:
        raise ValueError("the file is truncated: 12 bytes of header are missing")
    _, version, length = struct.unpack_from("<4sII", data)
    if version != 2:
        raise ValueError(f"GLB version {version} is not supported, only 2; export it again")
    if length > len(data):
        raise ValueError(f"the file is truncated: {len(data)} of {length} bytes")
    chunks: dict[int, bytes] = {}
    place = 12
    while place + 8 <= length:
        size, kind = struct.unpack_from("<II", data, place)
        if place + 8 + size > length:
            raise ValueError(f"the file is truncated: a chunk ends at byte {place + 8 + size} of {length}")
        chunks.setdefault(kind, data[place + 8 : place + 8 + size])
        place += 8 + size
    return chunks[_JSON], chunks.get(_BIN, b"")


def _normalised(values: NDArray[Any]) -> NDArray[Any]:
    if values.dtype.kind == "f":
        return values
    top = float(np.iinfo(values.dtype).max)
    return np.maximum(values / top, -1.0)


_WHITE: Colour = (1.0, 1.0, 1.0)
_FLIP: Affine = (1.0, 0.0, 0.0, 0.0, -1.0, 1.0)
"""v of glTF starts at the top, v of the renderer at the bottom."""


def read_surface(document: Document, index: int | None, user: str) -> tuple[Surface, bool]:
    """Returns the appearance of a material, and whether its back faces are visible.

    Args:
        document: opened file.
        index: number of the material; `None` is the default material, white.
        user: node for notes.
    """
    if index is None:
        return Surface(colour=_WHITE), False
    material = document.item("materials", index)
    extensions = material.get("extensions") or {}
    glossy = extensions.get("KHR_materials_pbrSpecularGlossiness")
    base = glossy or material.get("pbrMetallicRoughness") or {}
    factor = [float(value) for value in base.get("diffuseFactor" if glossy else "baseColorFactor") or (1, 1, 1, 1)]
    red, green, blue, alpha = factor
    strength = float((extensions.get("KHR_materials_emissive_strength") or {}).get("emissiveStrength", 1.0))
    glow = [float(value) * strength for value in material.get("emissiveFactor") or (0, 0, 0)]
    is_image = "emissiveTexture" in material
    surface = Surface(
        colour=(red, green, blue),
        fallback=(red, green, blue),
        opacity=alpha if material.get("alphaMode") == "BLEND" else 1.0,
        emits=max(glow) > 0.05,
        emission=(0.0, 0.0, 0.0) if is_image else (glow[0], glow[1], glow[2]),
        name=str(material.get("name") or ""),
    )
    texture = base.get("diffuseTexture" if glossy else "baseColorTexture")
    if texture is not None:
        surface = _textured(document, surface, texture, user)
    if surface.texture and material.get("alphaMode") == "BLEND":
        document.files.scene.notes.append(f"material {surface.name or index}: {BLEND_NOTE}")
    if material.get("alphaMode") == "MASK":
        surface = _cut_out(surface, float(material.get("alphaCutoff", 0.5)), alpha)
    return surface, bool(material.get("doubleSided", False))


def _cut_out(surface: Surface, cutoff: float, alpha: float) -> Surface:
    """Returns the surface with holes where the product of `alpha` and the texture's alpha is below `cutoff`."""
    if cutoff <= 0:
        return surface
    if not surface.texture or alpha <= 0:
        return surface if alpha >= cutoff else replace(surface, opacity=0.0)
    return replace(surface, cutout=Cutout(min(cutoff / alpha, 1.01), surface.texture))


def _textured(document: Document, surface: Surface, info: dict[str, Any], user: str) -> Surface:
    texture = document.item("textures", int(info["index"]))
    extensions = texture.get("extensions") or {}
    webp = extensions.get("EXT_texture_webp") or {}
    source = texture.get("source", webp.get("source"))
    if source is None:
        kinds = ", ".join(extensions) or "no image"
        remedy = f"; decode it with: {_rewrite(document, 'ktxdecompress')}{_KTX_PROGRAM}" if _KTX in extensions else ""
        document.files.scene.notes.append(f"{user}: texture of {kinds} is not supported, shown in one colour{remedy}")
        return surface
    transform = (info.get("extensions") or {}).get("KHR_texture_transform") or {}
    full = replace(
        surface,
        texture=document.image(int(source)),
        uv_set=f"TEXCOORD_{int(transform.get('texCoord', info.get('texCoord', 0)))}",
        uv_affine=_affine(transform),
    )
    if full.texture in document.files.images:
        return full
    return document.files.readable.kept_inside(full, user, document.files.scene.notes)


def _affine(transform: dict[str, Any]) -> Affine:
    """Returns the transform of texture coordinates (KHR_texture_transform). In the result, v starts at the bottom."""
    if not transform:
        return _FLIP
    su, sv = (float(value) for value in transform.get("scale", (1.0, 1.0)))
    tu, tv = (float(value) for value in transform.get("offset", (0.0, 0.0)))
    angle = float(transform.get("rotation", 0.0))
    c, s = cos(angle), sin(angle)
    return (c * su, s * sv, tu, s * su, -c * sv, 1.0 - tv)


_SUPPORTED = frozenset(
    {
        "KHR_texture_transform",
        "KHR_mesh_quantization",
        "KHR_materials_unlit",
        "KHR_materials_emissive_strength",
        "KHR_materials_pbrSpecularGlossiness",
        "KHR_lights_punctual",
        "EXT_mesh_gpu_instancing",
        "EXT_texture_webp",
    }
)
_KTX = "KHR_texture_basisu"
_IGNORABLE = ("KHR_materials_", "KHR_xmp", "KHR_animation", "EXT_lights_image_based")
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_Visit = tuple[int, str, Floats, tuple[int, ...]]
"""Node, path of its parent, transform (4, 4) parent -> file, and the nodes above it."""


@dataclass
class _Reader:
    document: Document
    content: Content
    names: Names = field(default_factory=Names)
    pieces: dict[int, tuple[Piece, ...]] = field(default_factory=dict)
    """Pieces by number of the mesh."""
    counts: Counter[str] = field(default_factory=Counter)
    """Note on a feature that is not imported -> number of its uses."""

    def note(self, text: str) -> None:
        self.document.files.scene.notes.append(text)


def read_gltf(data: bytes, files: SceneFiles) -> Content:
    """Reads a .gltf or .glb file.

    Args:
        data: content of the file.
        files: files of the import.

    Raises:
        ValueError: the file is truncated, not glTF 2.0, or needs an extension that is not supported.
        WorldError: a buffer is missing, or the file has too many triangles.
    """
    document = read_document(data, files)
    _require_extensions(document)
    reader = _Reader(document, Content(metres_per_unit=1.0, up="y"))
    scenes = document.items("scenes")
    roots = document.item("scenes", int(document.json.get("scene", 0)))["nodes"] if scenes else _roots(document)
    stack: list[_Visit] = [(int(index), "", np.eye(4), ()) for index in reversed(roots)]
    while stack:
        stack += reversed(list(_visit(reader, *stack.pop())))
    for what, count in (+reader.counts).items():
        reader.note(f"{count} {what}")
    return reader.content


_KTX_PROGRAM = " (needs the program ktx of KTX-Software)"


def _require_extensions(document: Document) -> None:
    needed = [str(name) for name in document.json.get("extensionsRequired") or ()]
    lacking = [name for name in needed if name not in _SUPPORTED and not name.startswith(_IGNORABLE)]
    if lacking:
        command = _rewrite(document, "ktxdecompress" if _KTX in lacking else "copy", is_error=True)
        needs = _KTX_PROGRAM if _KTX in lacking else ""
        raise ValueError(f"it needs {', '.join(lacking)}, not supported; export it without, or: {command}{needs}")


def _rewrite(document: Document, verb: str, is_error: bool = False) -> str:
    """Returns the command that writes the file without compressed meshes (`copy`) or pictures (`ktxdecompress`).

    A note contains the name of the file only, because notes are part of the package and equal on every machine.
    """
    root = document.files.root
    path = root if is_error and root.name == document.files.scene.file else Path(root.name)
    return f"npx @gltf-transform/cli {verb} {quoted(path)} {quoted(path.with_name(f'plain_{path.name}'))}"


def _roots(document: Document) -> list[int]:
    nodes = document.items("nodes")
    children = {int(child) for node in nodes for child in node.get("children") or ()}
    return [index for index in range(len(nodes)) if index not in children]


def _visit(reader: _Reader, index: int, parent: str, frame: Floats, above: tuple[int, ...]) -> Iterator[_Visit]:
    """Adds the shapes of a node. Yields its children with path and frame."""
    if index in above:
        raise ValueError(f"node {index} is its own descendant")
    node = reader.document.item("nodes", index)
    mesh = None if node.get("mesh") is None else reader.document.item("meshes", int(node["mesh"]))
    path = reader.names.path(parent, node.get("name") or (mesh or {}).get("name"), f"node_{index}")
    label = label_of(node.get("extras")) or label_of((mesh or {}).get("extras"))
    if label:
        reader.content.labels[path] = label
    extensions = node.get("extensions") or {}
    with np.errstate(all="ignore"):
        here = np.asarray(frame @ _local(node))
    if mesh is not None:
        _add(reader, path, int(node["mesh"]), here, extensions.get("EXT_mesh_gpu_instancing"))
        reader.counts["skinned meshes are read in their rest pose"] += "skin" in node
    reader.counts["lights of the file are not used; emissive materials light the scene"] += (
        "KHR_lights_punctual" in extensions
    )
    for child in node.get("children") or ():
        yield int(child), path, here, (*above, index)


def _local(node: dict[str, Any]) -> Floats:
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation") or (0, 0, 0, 1)
    matrix = quaternion_matrix((w, x, y, z))
    matrix[:3, :3] *= np.array(node.get("scale") or (1, 1, 1), np.float64)
    matrix[:3, 3] = node.get("translation") or (0, 0, 0)
    return matrix


def _add(reader: _Reader, path: str, mesh: int, here: Floats, instancing: dict[str, Any] | None) -> None:
    try:
        if mesh not in reader.pieces:
            reader.pieces[mesh] = tuple(_pieces(reader, path, mesh))
        copies = [np.eye(4)] if instancing is None else list(_copies(reader.document, instancing["attributes"]))
    except BROKEN as error:
        reader.note(f"{path}: skipped, {error}")
        return
    for number, copy in enumerate(copies):
        copy_path = path if instancing is None else f"{path}/copy[{number}]"
        reader.content.shapes.append(ShapeNode(copy_path, reader.pieces[mesh], here @ copy))


def _copies(document: Document, attributes: dict[str, int]) -> Iterator[Floats]:
    """Yields the transforms of EXT_mesh_gpu_instancing."""
    values = {name: document.accessor(int(index)) for name, index in attributes.items()}
    for number in range(len(next(iter(values.values())))):
        keys = {"TRANSLATION": "translation", "ROTATION": "rotation", "SCALE": "scale"}
        yield _local({key: values[name][number].tolist() for name, key in keys.items() if name in values})


def _pieces(reader: _Reader, path: str, mesh: int) -> Iterator[Piece]:
    for primitive in reader.document.item("meshes", mesh)["primitives"]:
        if "KHR_draco_mesh_compression" in (primitive.get("extensions") or {}) and not _has_plain(reader, primitive):
            raise ValueError(f"Draco compression is not supported; remove it with: {_rewrite(reader.document, 'copy')}")
        mode = int(primitive.get("mode", _TRIANGLES))
        if mode < _TRIANGLES:
            reader.counts["meshes of points or lines are omitted"] += 1
            continue
        yield _piece(reader, path, primitive, mode)


def _has_plain(reader: _Reader, primitive: dict[str, Any]) -> bool:
    """Returns whether a primitive with Draco compression has uncompressed points, too; it must if Draco is optional."""
    return "bufferView" in reader.document.item("accessors", int(primitive["attributes"]["POSITION"]))


def _piece(reader: _Reader, path: str, primitive: dict[str, Any], mode: int) -> Piece:
    document, attributes = reader.document, primitive["attributes"]
    points = document.accessor(int(attributes["POSITION"])).astype(np.float64)
    if points.shape[1] != 3:
        raise ValueError(f"points of {points.shape[1]} values")
    order = np.arange(len(points))
    if primitive.get("indices") is not None:
        order = document.accessor(int(primitive["indices"])).reshape(-1).astype(np.int64)
    corners = _triangles(order, mode)
    document.files.scene.require_room(path, len(corners))
    material = primitive.get("material")
    surface, is_two_sided = read_surface(document, None if material is None else int(material), path)
    piece = mesh_piece(points, corners, surface, is_two_sided=False)
    uvs = _uvs(document, attributes, surface, corners) if surface.texture else None
    if surface.texture and uvs is None:
        reader.note(f"{path}: textured but without texture coordinates, shown in one colour")
    tints = None
    if "COLOR_0" in attributes and not surface.texture:
        colours = document.accessor(int(attributes["COLOR_0"]))
        if len(colours) > corners.max(initial=-1):
            tints = colours[corners][..., :3] * np.array(surface.colour)
        else:
            reader.note(f"{path}: {len(colours)} vertex colours for {len(points)} vertices, ignored")
    piece = Piece(piece.triangles, uvs, tints, surface)
    return piece.both_sides() if is_two_sided else piece


def _uvs(document: Document, attributes: dict[str, Any], surface: Surface, corners: Ints) -> Floats | None:
    if surface.uv_set not in attributes or surface.uv_affine is None:
        return None
    every = document.accessor(int(attributes[surface.uv_set])).astype(np.float64)
    if len(every) <= corners.max(initial=-1):
        return None
    values = every[corners][..., :2]
    rows = np.array(surface.uv_affine).reshape(2, 3)
    return np.asarray(values @ rows[:, :2].T + rows[:, 2])


def _triangles(order: NDArray[np.int64], mode: int) -> Ints:
    """Returns the corners (T, 3) of triangles, a strip or a fan."""
    if mode == _TRIANGLES:
        return order[: len(order) // 3 * 3].reshape(-1, 3)
    number = np.arange(max(len(order) - 2, 0))
    if mode == _STRIP:
        odd = number % 2
        return np.asarray(order[np.stack([number, number + 1 + odd, number + 2 - odd], axis=1)])
    if mode != _FAN:
        raise ValueError(f"primitive mode {mode}")
    return np.asarray(order[np.stack([number + 1, number + 2, np.zeros_like(number)], axis=1)])
