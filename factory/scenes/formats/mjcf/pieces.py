"""Triangles of MuJoCo's geoms: solids, planes, meshes and height fields, in the frame of the geom."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from factory.scenes.formats.shapes import mesh_piece, solid_piece
from factory.scenes.importer.collect import Piece
from factory.scenes.importer.model import Surface
from factory.scenes.importer.solids import box, capsule, cylinder, plane, sphere

_INFINITE_M = 25.0
"""Half length that replaces the infinite side of a plane, metres."""
_GEOM = mujoco.mjtGeom


def geom_piece(model: Any, geom: int, surface: Surface) -> Piece | None:
    """Returns the triangles of a geom, or `None` for types that are not supported.

    Args:
        model: compiled model.
        geom: number of the geom.
        surface: its appearance.

    Raises:
        ValueError: its points are not finite.
    """
    kind, data = int(model.geom_type[geom]), int(model.geom_dataid[geom])
    x, y, z = (float(value) for value in model.geom_size[geom])
    if kind == _GEOM.mjGEOM_MESH:
        return _mesh(model, data, surface)
    if kind == _GEOM.mjGEOM_HFIELD:
        return _height_field(model, data, surface)
    if kind == _GEOM.mjGEOM_PLANE:
        return _plane(model, geom, (x or _INFINITE_M, y or _INFINITE_M), surface)
    if kind == _GEOM.mjGEOM_ELLIPSOID:
        points, counts, indices = sphere(1.0)
        return solid_piece((points * (x, y, z), counts, indices), surface)
    solids = {
        int(_GEOM.mjGEOM_BOX): lambda: box(x, y, z),
        int(_GEOM.mjGEOM_SPHERE): lambda: sphere(x),
        int(_GEOM.mjGEOM_CYLINDER): lambda: cylinder(x, x, y),
        int(_GEOM.mjGEOM_CAPSULE): lambda: capsule(x, x, y),
    }
    return solid_piece(solids[kind](), surface) if kind in solids else None


def _mesh(model: Any, mesh: int, surface: Surface) -> Piece:
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    rows = slice(int(model.mesh_faceadr[mesh]), int(model.mesh_faceadr[mesh]) + int(model.mesh_facenum[mesh]))
    points = np.asarray(model.mesh_vert[first : first + count], np.float64)
    uvs, first_uv = None, int(model.mesh_texcoordadr[mesh])
    if surface.texture and first_uv >= 0:
        uvs = np.asarray(model.mesh_texcoord, np.float64)[first_uv + model.mesh_facetexcoord[rows]]
        uvs = np.stack([uvs[..., 0], 1.0 - uvs[..., 1]], axis=-1)
    return mesh_piece(points, np.asarray(model.mesh_face[rows], np.int64), surface, uvs)


def _height_field(model: Any, field: int, surface: Surface) -> Piece:
    """Returns the surface of a height field, without its base and sides."""
    rows, columns, first = int(model.hfield_nrow[field]), int(model.hfield_ncol[field]), int(model.hfield_adr[field])
    half_x, half_y, top, _ = (float(value) for value in model.hfield_size[field])
    heights = np.asarray(model.hfield_data[first : first + rows * columns], np.float64) * top
    y, x = np.meshgrid(np.linspace(-half_y, half_y, rows), np.linspace(-half_x, half_x, columns), indexing="ij")
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]))
    corners = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return mesh_piece(np.stack([x.ravel(), y.ravel(), heights], axis=1), corners, surface, is_two_sided=True)


def _plane(model: Any, geom: int, half: tuple[float, float], surface: Surface) -> Piece:
    points, _, _ = plane(*half)
    corners = np.array([[0, 1, 2], [0, 2, 3]])
    uvs, material = None, int(model.geom_matid[geom])
    if surface.texture:
        repeat = np.asarray(model.mat_texrepeat[material], np.float64)
        size = 2.0 * np.array(half) if model.mat_texuniform[material] else np.ones(2)
        uvs = (points[:, :2] / (2.0 * np.array(half)) + 0.5)[corners] * repeat * size
    return mesh_piece(points, corners, surface, uvs, is_two_sided=False)
