"""Converts the geometric primitives of USD to polygons: cube, sphere, cylinder, cone, capsule, plane.

Polygons are in local units with outward winding. Does not transform them and does not read materials.
"""

from __future__ import annotations

from typing import Any

from pxr import UsdGeom

from factory.scenes.importer.solids import Polygons, box, capsule, cylinder, plane, sphere, turned


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
