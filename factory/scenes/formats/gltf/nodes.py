"""Reads glTF 2.0 files (.gltf, .glb): nodes with their transforms, triangles, materials and semantic extras.

Skins and animations are read in their rest pose. Lights are counted but not used; cameras are ignored.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from factory.scenes.formats.files import SceneFiles
from factory.scenes.formats.gltf.buffers import Document, read_document
from factory.scenes.formats.gltf.materials import read_surface
from factory.scenes.formats.poses import quaternion_matrix
from factory.scenes.formats.shapes import BROKEN, Content, Names, ShapeNode, label_of, mesh_piece
from factory.scenes.importer.collect import Piece
from factory.scenes.importer.model import Surface
from schemas.support.numpy_types import Floats, Ints

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


def _require_extensions(document: Document) -> None:
    needed = [str(name) for name in document.json.get("extensionsRequired") or ()]
    lacking = [name for name in needed if name not in _SUPPORTED and not name.startswith(_IGNORABLE)]
    if lacking:
        name = document.files.root.name
        raise ValueError(
            f"it needs {', '.join(lacking)}, not supported; export it without, or: npx gltf-transform copy {name} "
            f"plain_{name}"
        )


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
        own = path if instancing is None else f"{path}/copy[{number}]"
        reader.content.shapes.append(ShapeNode(own, reader.pieces[mesh], here @ copy))


def _copies(document: Document, attributes: dict[str, int]) -> Iterator[Floats]:
    """Yields the transforms of EXT_mesh_gpu_instancing."""
    values = {name: document.accessor(int(index)) for name, index in attributes.items()}
    for number in range(len(next(iter(values.values())))):
        keys = {"TRANSLATION": "translation", "ROTATION": "rotation", "SCALE": "scale"}
        yield _local({key: values[name][number].tolist() for name, key in keys.items() if name in values})


def _pieces(reader: _Reader, path: str, mesh: int) -> Iterator[Piece]:
    for primitive in reader.document.item("meshes", mesh)["primitives"]:
        if "KHR_draco_mesh_compression" in (primitive.get("extensions") or {}):
            raise ValueError("Draco compression is not supported; export the file without compression")
        mode = int(primitive.get("mode", _TRIANGLES))
        if mode < _TRIANGLES:
            reader.counts["meshes of points or lines are omitted"] += 1
            continue
        yield _piece(reader, path, primitive, mode)


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
        tints = document.accessor(int(attributes["COLOR_0"]))[corners][..., :3] * np.array(surface.colour)
    piece = Piece(piece.triangles, uvs, tints, surface)
    return piece.both_sides() if is_two_sided else piece


def _uvs(document: Document, attributes: dict[str, Any], surface: Surface, corners: Ints) -> Floats | None:
    if surface.uv_set not in attributes or surface.uv_affine is None:
        return None
    values = document.accessor(int(attributes[surface.uv_set])).astype(np.float64)[corners][..., :2]
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
