"""Reads the geometry and primvars of one USD prim in its local frame; converts geometric primitives to polygons.

Does not read materials and does not apply transforms.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdShade

from factory.scenes.importer.polygons import Triangulation, bounds_volume, triangulate
from factory.scenes.importer.solids import Polygons, box, capsule, cylinder, plane, sphere, turned
from schemas.support.numpy_types import Floats, Ints

_TIME = Usd.TimeCode.EarliestTime()
_UV_NAMES = ("st", "st0", "st_0", "UVMap", "map1", "uv")


@dataclass(frozen=True)
class ImportedMesh:
    """Triangulated polygons of one prim."""

    points: Floats
    """(N, 3) in the prim's frame and units."""
    counts: Ints
    """(F,) corners of each face."""
    indices: Ints
    """(C,) vertex of each face corner."""
    cut: Triangulation
    is_two_sided: bool
    """Whether the mesh is authored as double-sided and is not a closed surface."""

    def triangle_points(self) -> Floats:
        """Returns the corners (T, 3, 3) of the triangles."""
        return self.points[self.indices[self.cut.corners]]


def count_triangles(prim: Any) -> int:
    """Returns the number of triangles of a mesh without triangulating it; 0 for other prims and invalid topology."""
    if not prim.IsA(UsdGeom.Mesh):
        return 0
    mesh = UsdGeom.Mesh(prim)
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get(_TIME) or [], np.int64)
    is_whole = counts.sum() == len(mesh.GetFaceVertexIndicesAttr().Get(_TIME) or [])
    return int(np.maximum(counts - 2, 0).sum()) if is_whole else 0


def read_mesh(prim: Any, notes: list[str]) -> ImportedMesh | None:
    """Returns the geometry of a mesh or geometric primitive, or `None` for other prims.

    Args:
        prim: any prim.
        notes: list that receives notes on simplifications.

    Raises:
        ValueError: the topology is not valid.
    """
    if prim.IsA(UsdGeom.Mesh):
        return _polygon_mesh(prim, notes)
    if not prim.IsA(UsdGeom.Gprim):
        return None
    solid = solid_polygons(prim)
    if solid is None:
        notes.append(f"{prim.GetPath()}: {prim.GetTypeName()} is not supported, skipped")
        return None
    return ImportedMesh(*solid, triangulate(*solid), is_two_sided=str(prim.GetTypeName()) == "Plane")


def _polygon_mesh(prim: Any, notes: list[str]) -> ImportedMesh | None:
    mesh = UsdGeom.Mesh(prim)
    attributes = (mesh.GetPointsAttr(), mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr())
    raw = [attribute.Get(_TIME) for attribute in attributes]
    if any(values is None or len(values) == 0 for values in raw):
        notes.append(f"{prim.GetPath()}: mesh without points or faces, skipped")
        return None
    points, counts, indices = np.array(raw[0], np.float64), np.array(raw[1], np.int64), np.array(raw[2], np.int64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points must have the shape (N, 3), not {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError("points are not finite")
    if mesh.GetSubdivisionSchemeAttr().Get() != UsdGeom.Tokens.none and len(counts) < len(indices) / 3:
        notes.append(f"{prim.GetPath()}: subdivision surface shown by its control cage ({len(counts)} faces)")
    cut = _without_holes(triangulate(points, counts, indices), mesh.GetHoleIndicesAttr().Get(_TIME))
    if mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded:
        cut = Triangulation(cut.corners[:, ::-1], cut.faces)
    two_sided = bool(mesh.GetDoubleSidedAttr().Get()) and not bounds_volume(points, indices[cut.corners])
    return ImportedMesh(points, counts, indices=indices, cut=cut, is_two_sided=two_sided)


def _without_holes(cut: Triangulation, holes: Any) -> Triangulation:
    if holes is None or len(holes) == 0:
        return cut
    keep = ~np.isin(cut.faces, np.array(holes))
    return Triangulation(cut.corners[keep], cut.faces[keep])


def material_subsets(prim: Any, mesh: ImportedMesh) -> Iterator[tuple[Any, NDArray[np.bool_]]]:
    """Yields the prims that bind materials to a mesh, with the mask (T,) of their triangles. The masks are disjoint."""
    rest = np.ones(len(mesh.cut.faces), bool)
    subsets = UsdGeom.Subset.GetGeomSubsets(UsdGeom.Imageable(prim), UsdGeom.Tokens.face, UsdShade.Tokens.materialBind)
    for subset in subsets:
        faces = np.array(subset.GetIndicesAttr().Get(_TIME) or [], np.int64)
        chosen = np.isin(mesh.cut.faces, faces) & rest
        rest &= ~chosen
        if chosen.any():
            yield subset.GetPrim(), chosen
    if rest.any():
        yield prim, rest


def corner_values(prim: Any, mesh: ImportedMesh, name: str) -> Floats | None:
    """Returns the values (T, 3, k) of a primvar at the triangle corners, or `None` if it is missing or not valid."""
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(name)
    if not primvar or not primvar.HasValue():
        return None
    flat = primvar.ComputeFlattened(_TIME)
    if flat is None:  # indices out of range; USD warns
        return None
    values = np.array(flat, np.float64)
    corners = len(mesh.indices)
    kind = primvar.GetInterpolation()
    if kind == UsdGeom.Tokens.faceVarying:
        spread = values
    elif kind in (UsdGeom.Tokens.vertex, UsdGeom.Tokens.varying):
        spread = values[mesh.indices] if len(values) == len(mesh.points) else values[:0]
    elif kind == UsdGeom.Tokens.uniform:
        spread = np.repeat(values, mesh.counts, axis=0) if len(values) == len(mesh.counts) else values[:0]
    else:
        spread = np.repeat(values[:1], corners, axis=0)
    return spread[mesh.cut.corners] if len(spread) == corners and values.ndim == 2 else None


def uv_values(prim: Any, mesh: ImportedMesh, uv_set: str) -> Floats | None:
    """Returns texture coordinates (T, 3, 2) from the named primvar, or else from the default primvars."""
    for name in (uv_set, *_UV_NAMES):
        values = corner_values(prim, mesh, name)
        if values is not None and values.shape[-1] >= 2:
            return values[..., :2]
    return None


def solid_polygons(prim: Any) -> Polygons | None:
    """Returns the polygons of a geometric primitive, or `None` for other prims."""
    kind = str(prim.GetTypeName())
    if kind == "Cube":
        half = float(UsdGeom.Cube(prim).GetSizeAttr().Get()) / 2
        return box(half, half, half)
    if kind == "Plane":
        usd_plane = UsdGeom.Plane(prim)
        axis = str(usd_plane.GetAxisAttr().Get())
        sides = usd_plane.GetWidthAttr().Get() / 2, usd_plane.GetLengthAttr().Get() / 2
        return turned(plane(*(sides if axis == "Z" else sides[::-1])), axis)
    if kind == "Sphere":
        return sphere(float(UsdGeom.Sphere(prim).GetRadiusAttr().Get()))
    solid = _rotational(prim, kind)
    return None if solid is None else turned(solid, str(prim.GetAttribute("axis").Get() or "Z"))


def _rotational(prim: Any, kind: str) -> Polygons | None:
    """Returns a solid along z, or `None` for kinds that are not rotational solids."""
    if not kind.startswith(("Cylinder", "Cone", "Capsule")):
        return None
    half = float(prim.GetAttribute("height").Get()) / 2
    names = ("radius", "radius") if prim.HasAttribute("radius") else ("radiusBottom", "radiusTop")
    bottom, top = (float(prim.GetAttribute(name).Get()) for name in names)
    if kind.startswith("Cone"):
        return cylinder(bottom, 0.0, half)
    return cylinder(bottom, top, half) if kind.startswith("Cylinder") else capsule(bottom, top, half)
