"""Reads COLLADA files (.dae) with pycollada: nodes, triangles, materials, unit and up axis.

Controllers are read in their rest pose, without their skin. Lights and cameras are ignored.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import tostring

import collada
import numpy as np

from factory.scenes.formats.files import SceneFiles
from factory.scenes.formats.shapes import BROKEN, Content, Names, ShapeNode, display_colour, mesh_piece
from factory.scenes.formats.xml_text import parse_xml
from factory.scenes.importer.collect import Piece
from factory.scenes.importer.content import Surface
from factory.scenes.importer.polygons import triangulate
from schemas.support.numpy_types import Floats, Ints

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

_SPACE = "{*}"
_OPTIONAL = ("NORMAL", "TEXCOORD", "TEXTANGENT", "TEXBINORMAL")
_UP = {"X_UP": None, "Y_UP": "y", "Z_UP": "z"}
_DEEPEST = 200


@dataclass
class _Reader:
    path: Path
    files: SceneFiles
    content: Content
    names: Names = field(default_factory=Names)
    surfaces: dict[str, tuple[Surface, bool]] = field(default_factory=dict)
    """Surface and double-sidedness, by the id of the material."""


def read_collada(data: bytes, path: Path, files: SceneFiles) -> Content:
    """Reads a COLLADA file.

    Args:
        data: content of the file.
        path: path of the file; textures are relative to it.
        files: files of the import.

    Raises:
        ValueError: the file is not valid, or contains XML entities.
        WorldError: the file has too many triangles.
    """
    root = parse_xml(data)  # pycollada's parser expands entities
    document = _parsed(data)
    if any(isinstance(error, collada.common.DaeMalformedError) for error in document.errors):
        # pycollada drops a mesh whose normals or texture coordinates have a bad index, and gives no warning
        files.scene.notes += [f"{path.name} {note}" for note in _drop_bad_inputs(root)]
        document = _parsed(tostring(root))
    lost = (error for error in document.errors if not isinstance(error, collada.common.DaeUnsupportedError))
    files.scene.notes += [f"{path.name}: {' '.join(str(error).split())[:300]}" for error in lost]
    unit = document.assetInfo.unitmeter
    content = Content(
        metres_per_unit=1.0 if unit is None else float(unit), up=_UP.get(str(document.assetInfo.upaxis), "y")
    )
    reader = _Reader(path, files, content)
    for node in [] if document.scene is None else document.scene.nodes:
        _visit(reader, node, "", np.eye(4), 0)
    return content


def _parsed(data: bytes) -> Any:
    try:
        return collada.Collada(io.BytesIO(data), ignore=[collada.common.DaeError])
    except collada.common.DaeError as error:
        raise ValueError(f"{error}") from error


def _drop_bad_inputs(root: Element) -> Iterator[str]:
    """Marks the inputs of meshes that have an index beyond the end of their source as unused.

    Yields a note for each input of texture coordinates. Normals are not read, so they need no note.
    """
    counts = {
        source.get("id"): int(accessor.get("count") or 0)
        for source in root.findall(f".//{_SPACE}source")
        for accessor in source.findall(f".//{_SPACE}accessor")
    }
    for geometry in root.findall(f".//{_SPACE}geometry"):
        for primitive in geometry.iter():
            inputs = primitive.findall(f"{_SPACE}input")
            texts = [text.text or "" for text in primitive.findall(f"{_SPACE}p")]
            rows = np.array(" ".join(texts).split(), np.int64)
            stride = 1 + max((int(each.get("offset") or 0) for each in inputs), default=0)
            for each in inputs if len(rows) and len(rows) % stride == 0 else ():
                column, count = rows[int(each.get("offset") or 0) :: stride], counts.get(str(each.get("source"))[1:])
                if each.get("semantic") in _OPTIONAL and count is not None and column.max() >= count:
                    if each.get("semantic") == "TEXCOORD":
                        used = f"texture coordinates 0 to {column.max()} are used, but there are {count}"
                        yield f"{geometry.get('name') or geometry.get('id')}: {used}; shown without texture"
                    each.set("semantic", "UNUSED")


def _visit(reader: _Reader, node: Any, parent: str, frame: Floats, depth: int) -> None:
    if depth > _DEEPEST:
        raise ValueError(f"nodes are nested more than {_DEEPEST} deep")
    if isinstance(node, collada.scene.GeometryNode):
        _add(reader, node.geometry, node.materials, parent, frame)
    elif isinstance(node, collada.scene.ControllerNode):
        _add(reader, node.controller.geometry, node.materials, parent, frame)
    elif isinstance(node, collada.scene.NodeNode):
        _visit(reader, node.node, parent, frame, depth + 1)
    elif isinstance(node, collada.scene.Node):
        path = reader.names.path(parent, _name_of(node), "node")
        here = np.asarray(frame @ np.asarray(node.matrix, np.float64))
        for child in node.children or ():
            _visit(reader, child, path, here, depth + 1)


def _name_of(node: Any) -> str:
    xml = getattr(node, "xmlnode", None)
    return str(getattr(node, "name", None) or (xml.get("name") if xml is not None else "") or node.id or "")


def _add(reader: _Reader, geometry: Any, bindings: Any, parent: str, frame: Floats) -> None:
    materials = {binding.symbol: binding.target for binding in bindings}
    path = parent or reader.names.path("", str(geometry.name or geometry.id), "mesh")
    pieces = []
    for primitive in geometry.primitives:
        try:
            pieces += list(_pieces(reader, primitive, materials.get(primitive.material), path))
        except BROKEN as error:
            reader.files.scene.notes.append(f"{reader.path.name} {path}: skipped, {error}")
    if pieces:
        reader.content.shapes.append(ShapeNode(path, tuple(pieces), frame))


def _pieces(reader: _Reader, primitive: Any, material: Any, path: str) -> Iterator[Piece]:
    if isinstance(primitive, collada.lineset.LineSet) or primitive.vertex is None:
        return
    points = np.asarray(primitive.vertex, np.float64)
    counts, rows = _faces(primitive)
    reader.files.scene.require_room(path, int(np.maximum(counts - 2, 0).sum()))
    cut = triangulate(points, counts, rows)
    surface, is_two_sided = _surface(reader, material, path)
    uvs = None
    if primitive.texcoordset:
        texcoords = np.asarray(primitive.texcoord_indexset[0], np.int64).reshape(-1)
        uvs = np.asarray(primitive.texcoordset[0], np.float64)[texcoords[cut.corners]][..., :2]
    yield mesh_piece(points, rows[cut.corners], surface, uvs, is_two_sided=True if is_two_sided else None)


def _faces(primitive: Any) -> tuple[Ints, Ints]:
    """Returns the number of corners of each face (F,), and the vertex of each corner (C,)."""
    if isinstance(primitive, collada.polylist.Polylist):  # `Polygons` is a subclass
        return np.asarray(primitive.vcounts, np.int64), np.asarray(primitive.vertex_index, np.int64).reshape(-1)
    rows = np.asarray(primitive.vertex_index, np.int64).reshape(-1)
    return np.full(len(rows) // 3, 3), rows


def _surface(reader: _Reader, material: Any, path: str) -> tuple[Surface, bool]:
    effect = getattr(material, "effect", None)
    if effect is None:
        return Surface(), False
    if material.id not in reader.surfaces:
        named = replace(_read_surface(reader, effect, path), name=str(material.name or material.id))
        reader.surfaces[material.id] = named, bool(effect.double_sided)
    return reader.surfaces[material.id]


def _read_surface(reader: _Reader, effect: Any, path: str) -> Surface:
    glow = _colour(effect.emission) or (0.0, 0.0, 0.0)
    plain = _colour(effect.diffuse)
    surface = Surface(colour=plain or (1.0, 1.0, 1.0), opacity=_opacity(effect), emits=max(glow) > 0.05, emission=glow)
    if not isinstance(effect.diffuse, collada.material.Map):
        return surface if plain else Surface(opacity=surface.opacity, emits=surface.emits, emission=glow)
    image = effect.diffuse.sampler.surface.image
    return reader.files.textured(surface, reader.path.parent, str(image.path), f"{reader.path.name} {path}")


def _colour(value: Any) -> tuple[float, float, float] | None:
    if value is None or isinstance(value, collada.material.Map):
        return None
    return display_colour(*(float(channel) for channel in list(value)[:3]))


def _opacity(effect: Any) -> float:
    """Returns the opacity; 1 for effects that are fully transparent, which many exporters write for opaque ones."""
    transparent, factor = effect.transparent, effect.transparency
    if transparent is None or factor is None or isinstance(transparent, collada.material.Map):
        return 1.0
    is_zero = effect.opaque_mode == collada.material.OPAQUE_MODE.RGB_ZERO
    colour = [float(channel) for channel in list(transparent)]
    value = 1.0 - float(np.mean(colour[:3])) * float(factor) if is_zero else colour[-1] * float(factor)
    return value if value > 0.0 else 1.0
