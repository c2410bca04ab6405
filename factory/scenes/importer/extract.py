"""Extracts the parts of a stage: triangles in world metres with their appearance, and notes on skipped prims.

A malformed prim adds a note and does not stop the extraction. Does not assign categories and builds no collider.
"""

from __future__ import annotations

import hashlib
import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdUtils

from factory.scenes.importer.assets import ReadableFolder, read_asset
from factory.scenes.importer.collect import Collector, Piece
from factory.scenes.importer.content import Extraction, Part, Surface
from factory.scenes.importer.diagnostics import format_error, text_of
from factory.scenes.importer.material import bound_material, read_surface
from factory.scenes.importer.prims import (
    ImportedMesh,
    corner_values,
    count_triangles,
    material_subsets,
    read_mesh,
    uv_values,
)
from factory.scenes.importer.stage import (
    BROKEN_PRIM,
    PrimPlacement,
    find_unseen,
    open_stage,
    take_warnings,
    walk_stage,
)
from factory.scenes.limits import USUAL_LIMITS, StageLimits
from schemas.support.numpy_types import Floats

_HARMLESS = "MaterialBindingAPI"
"""Word in the two warnings of USD on each prim that binds a material without applying this schema, as apps for phone
scans write it; the binding is read, so nothing is lost."""
_COLLIDER_NAME = re.compile(r"colli(sion|der)|(^|_)(ucx|ubx|phys(ics)?)(_|$)", re.IGNORECASE)


@dataclass
class _Extractor:
    scene: Collector
    readable: ReadableFolder
    surfaces: dict[str, Surface | None] = field(default_factory=dict)
    pieces: dict[tuple[str, str], list[Piece]] = field(default_factory=dict)


def extract_stage(path: Path, limits: StageLimits = USUAL_LIMITS) -> Extraction:
    """Extracts the content of a stage.

    Args:
        path: root layer of the stage.
        limits: limits of the import.

    Raises:
        UsageError: the file does not exist.
        WorldError: the file is not a stage, its units are not valid, or it has too many triangles.
    """
    content = Collector(path.name, limits)
    notes = content.notes
    scene = open_stage(path, notes)
    work = _Extractor(content, ReadableFolder(path, limits.allow_outside))
    listener = UsdUtils.CoalescingDiagnosticDelegate()  # as long as it exists, USD prints no warning
    for placement in walk_stage(scene, notes):
        try:
            _take(work, placement)
        except BROKEN_PRIM as error:
            notes.append(f"{placement.path}: skipped, {format_error(text_of(error.__str__))}")
    notes += take_warnings(listener, ignored=_HARMLESS)
    if all(part.is_collider for part in content.parts):
        notes += find_unseen(scene)
    digests = _digests(scene.stage, content.parts)
    return content.extraction(scene.metres_per_unit, {_seen_from(path, place): sha for place, sha in digests})


def _take(work: _Extractor, placement: PrimPlacement) -> None:
    prim, scene = placement.prim, work.scene
    kind = Usd.ModelAPI(prim).GetKind()
    if prim.IsA(UsdGeom.Scope) or kind in ("group", "assembly"):
        scene.groups.add(placement.path)
    if kind == "component":
        scene.components.add(placement.path)
    if prim.IsInstance() or kind == "component" or placement.path.endswith("]"):
        scene.models.add(placement.path)
    label = _label(prim)
    if label:
        scene.labels[placement.path] = label
    if not prim.IsA(UsdGeom.Gprim):
        return
    purpose = UsdGeom.Imageable(prim).ComputePurpose()
    collides = purpose == UsdGeom.Tokens.guide and _is_collider(prim)
    if purpose in (UsdGeom.Tokens.default_, UsdGeom.Tokens.render) or collides:
        scene.place(placement.path, _pieces(work, placement), placement.to_world, collides)


def _label(prim: Any) -> str:
    """Returns the semantic label of a prim (`UsdSemantics`, or the older `semantic:` attributes of Isaac), or ""."""
    for attribute in prim.GetAuthoredAttributes():
        name = attribute.GetName()
        if name.startswith("semantics:labels:") or (name.startswith("semantic:") and name.endswith("semanticData")):
            value = attribute.Get()
            return str(value if isinstance(value, str) else (list(value or [""]) or [""])[0])
    return ""


def _is_collider(prim: Any) -> bool:
    return "PhysicsCollisionAPI" in prim.GetAppliedSchemas() or bool(_COLLIDER_NAME.search(prim.GetName()))


def _source_path(prim: Any) -> str:
    """Returns the path of the prim that has the data; for an instance, its prototype."""
    return str(prim.GetPrimInPrototype().GetPath() if prim.IsInstanceProxy() else prim.GetPath())


def _pieces(work: _Extractor, placement: PrimPlacement) -> list[Piece]:
    """Returns the pieces of a prim, cached for all instances with the same appearance."""
    prim = placement.prim
    material = bound_material(prim)
    look = _source_path(material.GetPrim()) if material else ""
    colour = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance("displayColor")
    if not look and colour:
        look = _source_path(colour.GetAttr().GetPrim())
    key = (_source_path(prim), look)
    if key not in work.pieces:
        # checked here, so a mesh that is too large is not triangulated
        work.scene.require_room(placement.path, count_triangles(prim))
        mesh = read_mesh(prim, work.scene.notes)
        work.pieces[key] = [] if mesh is None else _cut_pieces(work, prim, mesh)
    return work.pieces[key]


def _cut_pieces(work: _Extractor, prim: Any, mesh: ImportedMesh) -> list[Piece]:
    pieces = []
    triangles = mesh.triangle_points()
    for binder, chosen in material_subsets(prim, mesh):
        surface = _surface(work, binder)
        tints = corner_values(prim, mesh, "displayColor") if surface is None else None
        surface = Surface() if surface is None else surface
        uvs = uv_values(prim, mesh, surface.uv_set) if surface.texture else None
        if surface.texture and uvs is None:
            work.scene.notes.append(f"{prim.GetPath()}: textured but without texture coordinates, shown in one colour")
        piece = Piece(triangles[chosen], _transformed(uvs, surface, chosen), _of(tints, chosen), surface)
        pieces.append(piece.both_sides() if mesh.is_two_sided else piece)
    return pieces


def _surface(work: _Extractor, binder: Any) -> Surface | None:
    material = bound_material(binder)
    if material is None:
        return None
    path = _source_path(material.GetPrim())
    if path not in work.surfaces:
        surface = read_surface(material, work.scene.notes)
        work.surfaces[path] = None if surface is None else work.readable.kept_inside(surface, path, work.scene.notes)
    return work.surfaces[path]


def _of(values: Floats | None, chosen: NDArray[np.bool_]) -> Floats | None:
    return None if values is None else values[chosen]


def _transformed(uvs: Floats | None, surface: Surface, chosen: NDArray[np.bool_]) -> Floats | None:
    transformed = _of(uvs, chosen)
    if transformed is None or surface.uv_affine is None:
        return transformed
    rows = np.array(surface.uv_affine).reshape(2, 3)
    return np.asarray(transformed @ rows[:, :2].T + rows[:, 2])


def _digests(stage: Any, parts: list[Part]) -> list[tuple[str, str]]:
    """Returns the paths and content digests of layers and textures."""
    layers = [layer.realPath for layer in stage.GetUsedLayers() if not layer.anonymous]
    textures = sorted(frozenset().union(*(part.surface.images for part in parts)))
    return [(place, hashlib.sha256(read_asset(place) or b"").hexdigest()) for place in [*layers, *textures]]


def _seen_from(root_layer: Path, place: str) -> str:
    """Returns a path relative to the folder of the root layer; unchanged if USD cannot resolve it."""
    return os.path.relpath(place, root_layer.parent) if Path(place).is_absolute() else place
