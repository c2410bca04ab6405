"""Reads STL and PLY files with trimesh: triangles, solids of ASCII STL, vertex colours and a texture of PLY.

Neither format states its unit or up axis.
"""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import numpy as np
from trimesh.exchange.ply import load_ply
from trimesh.exchange.stl import load_stl

from factory.scenes.formats.files import SceneFiles
from factory.scenes.formats.shapes import Content, Names, ShapeNode, mesh_piece
from factory.scenes.importer.content import Surface
from schemas.appearance.colour_names import linear_of
from schemas.support.numpy_types import Floats, Ints

_TEXTURE = re.compile(rb"comment\s+texturefile\s+(\S[^\r\n]*)", re.IGNORECASE)
_HEADER_BYTES = 1 << 16


def read_stl(data: bytes, path: Path, files: SceneFiles) -> Content:
    """Reads a binary or ASCII STL file; each solid is a shape.

    Raises:
        ValueError: the file is truncated or not valid.
        WorldError: the file has too many triangles.
    """
    mesh = load_stl(io.BytesIO(data))
    solids = mesh.get("geometry", {path.stem: mesh})
    content, names = Content(metres_per_unit=None, up=None), Names()
    for name, solid in solids.items():
        corners = np.asarray(solid["faces"], np.int64)
        files.scene.require_room(path.name, len(corners))
        piece = mesh_piece(np.asarray(solid["vertices"], np.float64), corners, Surface())
        content.shapes.append(ShapeNode(names.path("", str(name), "solid"), (piece,), np.eye(4)))
    if not content.shapes:
        raise ValueError("it contains no triangles, or it is truncated")
    return content


def read_ply(data: bytes, path: Path, files: SceneFiles) -> Content:
    """Reads an ASCII or binary PLY file as one shape.

    Raises:
        ValueError: the file is truncated, not valid, or a point cloud.
        WorldError: the file has too many triangles.
    """
    mesh = load_ply(io.BytesIO(data), skip_materials=True)
    if mesh.get("faces") is None:
        raise ValueError("it has no faces; reconstruct a mesh of the point cloud first")
    points, corners = np.asarray(mesh["vertices"], np.float64), _triangles(np.asarray(mesh["faces"]))
    files.scene.require_room(path.name, len(corners))
    surface, texture = Surface(), _TEXTURE.search(data[:_HEADER_BYTES].partition(b"end_header")[0])
    uvs = getattr(mesh.get("visual"), "uv", None)
    if texture:
        name = texture[1].decode("utf-8", errors="replace").strip()
        surface = files.textured(Surface(colour=(1.0, 1.0, 1.0)), path.parent, name, path.name)
    values = None if uvs is None else np.asarray(uvs, np.float64)[corners]
    piece = mesh_piece(points, corners, surface=surface, uvs=values, tints=_tints(mesh, corners))
    content = Content(metres_per_unit=None, up=None)
    content.shapes.append(ShapeNode(Names().path("", path.stem, "mesh"), (piece,), np.eye(4)))
    return content


def _triangles(faces: Ints) -> Ints:
    """Returns faces (T, 3), with quadrilaterals (Q, 4) cut in two."""
    cut = np.asarray(faces, np.int64)
    return cut if cut.shape[1] == 3 else np.concatenate([cut[:, [0, 1, 2]], cut[:, [0, 2, 3]]])


def _tints(attributes: dict[str, Any], corners: Ints) -> Floats | None:
    """Returns linear colours (T, 3, 3) of the vertices or faces, if the file has them."""
    for key, rows in (("vertex_colors", corners), ("face_colors", np.arange(len(corners))[:, None].repeat(3, axis=1))):
        colours = attributes.get(key)
        if colours is not None and len(colours) > rows.max(initial=-1):
            values = np.asarray(colours)[:, :3]
            scale = 1.0 if values.dtype.kind == "f" and values.max(initial=0.0) <= 1.0 else 255.0
            return linear_of(np.clip(values / scale, 0.0, 1.0))[rows]
    return None
