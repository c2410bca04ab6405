"""Extracts the parts of a stage: triangles in world metres with their appearance, and notes on skipped prims.

A malformed prim adds a note and does not stop the extraction. Does not assign categories and builds no collider.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from factory.scenes.importer.assets import read_asset
from factory.scenes.importer.diagnostics import format_error, text_of
from factory.scenes.importer.material import Surface, bound_material, read_surface
from factory.scenes.importer.mesh import (
    ImportedMesh,
    corner_values,
    count_triangles,
    material_subsets,
    read_mesh,
    uv_values,
)
from factory.scenes.importer.outside_files import ReadableFolder
from factory.scenes.importer.stage import BROKEN_PRIM, PrimPlacement, find_unseen, open_stage, walk_stage
from factory.scenes.limits import USUAL_LIMITS, StageLimits
from schemas.errors import WorldError
from schemas.support.numpy_types import Floats

_COLLIDER_NAME = re.compile(r"colli(sion|der)|(^|_)(ucx|ubx|phys(ics)?)(_|$)", re.IGNORECASE)


@dataclass(frozen=True)
class Part:
    """Triangles of one prim with one material, in world coordinates."""

    path: str
    """Path of the prim, unique per instance."""
    triangles: Floats
    """(T, 3, 3) corners, world metres, z up, counter-clockwise from outside."""
    uvs: Floats | None
    """(T, 3, 2) texture coordinates, v = 0 at the bottom."""
    tints: Floats | None
    """(T, 3, 3) linear vertex colours, if the prim has them."""
    surface: Surface
    is_collider: bool = False
    """Whether the part is authored for collision only and is not visible."""


@dataclass(frozen=True)
class Extraction:
    """Content of a stage, in the order of its prims."""

    parts: tuple[Part, ...]
    metres_per_unit: float
    labels: dict[str, str]
    """Prim path -> authored semantic label."""
    groups: frozenset[str]
    """Paths of grouping prims: scopes and prims of kind group or assembly."""
    models: frozenset[str]
    """Paths of prims that are one object: instances, copies and prims of kind component."""
    components: frozenset[str]
    """Paths of prims of kind component; their descendants are not separate objects."""
    sha256: str
    """SHA-256 of the layers and textures of the stage."""
    files_sha256: str
    """SHA-256 of the layers and textures with their paths relative to the root layer; swapped files change it."""
    notes: tuple[str, ...]
    ceiling_m: float | None = None
    """Height above the floor of a ceiling to add, metres."""


@dataclass(frozen=True)
class _Piece:
    """Triangles of a prim in its local frame, shared by all instances."""

    triangles: Floats
    uvs: Floats | None
    tints: Floats | None
    surface: Surface


@dataclass
class _Extractor:
    notes: list[str]
    readable: ReadableFolder
    file: str
    max_triangles: int
    surfaces: dict[str, Surface | None] = field(default_factory=dict)
    pieces: dict[tuple[str, str], list[_Piece]] = field(default_factory=dict)
    parts: list[Part] = field(default_factory=list)
    labels: dict[str, str] = field(default_factory=dict)
    groups: set[str] = field(default_factory=set)
    models: set[str] = field(default_factory=set)
    components: set[str] = field(default_factory=set)
    triangles: int = 0


def extract_stage(path: Path, limits: StageLimits = USUAL_LIMITS) -> Extraction:
    """Extracts the content of a stage.

    Args:
        path: root layer of the stage.
        limits: limits of the import.

    Raises:
        UsageError: the file does not exist.
        WorldError: the file is not a stage, its units are not valid, or it has too many triangles.
    """
    notes: list[str] = []
    scene = open_stage(path, notes)
    work = _Extractor(notes, ReadableFolder(path, limits.allow_outside), path.name, limits.max_triangles)
    for placement in walk_stage(scene, notes):
        try:
            _take(work, placement)
        except BROKEN_PRIM as error:
            notes.append(f"{placement.path}: skipped, {format_error(text_of(error.__str__))}")
    if all(part.is_collider for part in work.parts):
        notes += find_unseen(scene)
    digests = _digests(scene.stage, work.parts)
    added = [] if limits.ceiling_m is None else [f"ceiling {limits.ceiling_m}"]
    return Extraction(
        parts=tuple(work.parts),
        metres_per_unit=scene.metres_per_unit,
        labels=work.labels,
        groups=frozenset(work.groups),
        models=frozenset(work.models),
        components=frozenset(work.components),
        sha256=_digest_of(sorted(digest for _, digest in digests) + added),
        files_sha256=_digest_of(sorted(f"{_seen_from(path, place)} {digest}" for place, digest in digests) + added),
        notes=tuple(dict.fromkeys(notes)),
        ceiling_m=limits.ceiling_m,
    )


def _take(work: _Extractor, placement: PrimPlacement) -> None:
    prim = placement.prim
    kind = Usd.ModelAPI(prim).GetKind()
    if prim.IsA(UsdGeom.Scope) or kind in ("group", "assembly"):
        work.groups.add(placement.path)
    if kind == "component":
        work.components.add(placement.path)
    if prim.IsInstance() or kind == "component" or placement.path.endswith("]"):
        work.models.add(placement.path)
    label = _label(prim)
    if label:
        work.labels[placement.path] = label
    if not prim.IsA(UsdGeom.Gprim):
        return
    purpose = UsdGeom.Imageable(prim).ComputePurpose()
    collides = purpose == UsdGeom.Tokens.guide and _is_collider(prim)
    if purpose in (UsdGeom.Tokens.default_, UsdGeom.Tokens.render) or collides:
        pieces = _pieces(work, placement)
        more = sum(len(piece.triangles) for piece in pieces)
        _require_room(work, placement.path, more)
        work.triangles += more
        work.parts += [_placed(piece, placement, collides) for piece in pieces]


def _require_room(work: _Extractor, path: str, more: int) -> None:
    if work.triangles + more <= work.max_triangles:
        return
    counts = Counter({path: more})
    counts.update({part.path: len(part.triangles) for part in work.parts})
    largest = ", ".join(f"{prim} ({count})" for prim, count in counts.most_common(3))
    raise WorldError(
        f"{work.file} has more than {work.max_triangles} triangles, exceeded at prim {path}; the largest prims so "
        "far are "
        f"{largest}; "
        "decimate or deactivate them, split the stage, or raise --max-triangles if memory allows"
    )


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


def _pieces(work: _Extractor, placement: PrimPlacement) -> list[_Piece]:
    """Returns the pieces of a prim, cached for all instances with the same appearance."""
    prim = placement.prim
    material = bound_material(prim)
    look = _source_path(material.GetPrim()) if material else ""
    colour = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance("displayColor")
    if not look and colour:
        look = _source_path(colour.GetAttr().GetPrim())
    key = (_source_path(prim), look)
    if key not in work.pieces:
        _require_room(work, placement.path, count_triangles(prim))  # before a mesh that is too large is triangulated
        mesh = read_mesh(prim, work.notes)
        work.pieces[key] = [] if mesh is None else _cut_pieces(work, prim, mesh)
    return work.pieces[key]


def _cut_pieces(work: _Extractor, prim: Any, mesh: ImportedMesh) -> list[_Piece]:
    pieces = []
    triangles = mesh.triangle_points()
    for binder, chosen in material_subsets(prim, mesh):
        surface = _surface(work, binder)
        tints = corner_values(prim, mesh, "displayColor") if surface is None else None
        surface = Surface() if surface is None else surface
        uvs = uv_values(prim, mesh, surface.uv_set) if surface.texture else None
        if surface.texture and uvs is None:
            work.notes.append(f"{prim.GetPath()}: textured but without texture coordinates, shown in one colour")
        piece = _Piece(triangles[chosen], _transformed(uvs, surface, chosen), _of(tints, chosen), surface)
        pieces.append(_both_sides(piece) if mesh.is_two_sided else piece)
    return pieces


def _surface(work: _Extractor, binder: Any) -> Surface | None:
    material = bound_material(binder)
    if material is None:
        return None
    path = _source_path(material.GetPrim())
    if path not in work.surfaces:
        surface = read_surface(material, work.notes)
        work.surfaces[path] = None if surface is None else work.readable.kept_inside(surface, path, work.notes)
    return work.surfaces[path]


def _of(values: Floats | None, chosen: NDArray[np.bool_]) -> Floats | None:
    return None if values is None else values[chosen]


def _transformed(uvs: Floats | None, surface: Surface, chosen: NDArray[np.bool_]) -> Floats | None:
    found = _of(uvs, chosen)
    if found is None or surface.uv_affine is None:
        return found
    rows = np.array(surface.uv_affine).reshape(2, 3)
    return np.asarray(found @ rows[:, :2].T + rows[:, 2])


def _both_sides(piece: _Piece) -> _Piece:
    """Adds the back face of every triangle, because the renderer culls back faces."""

    def doubled(values: Floats | None) -> Floats | None:
        return None if values is None else np.concatenate([values, values[:, ::-1]])

    both = np.concatenate([piece.triangles, piece.triangles[:, ::-1]])
    return replace(piece, triangles=both, uvs=doubled(piece.uvs), tints=doubled(piece.tints))


def _placed(piece: _Piece, placement: PrimPlacement, collides: bool) -> Part:
    rotation, shift = placement.to_world[:3, :3], placement.to_world[:3, 3]
    with np.errstate(all="ignore"):
        exact = piece.triangles @ rotation.T + shift
        triangles = exact.astype(np.float32).astype(
            np.float64
        )  # the last bit depends on the processor: schemas.support.portable
    uvs, tints = piece.uvs, piece.tints
    if not np.isfinite(triangles).all():
        raise ValueError("points or transform are not finite")
    if np.linalg.det(rotation) < 0:  # mirroring reverses the winding
        triangles = triangles[:, ::-1]
        uvs = None if uvs is None else uvs[:, ::-1]
        tints = None if tints is None else tints[:, ::-1]
    return Part(placement.path, triangles, uvs, tints, piece.surface, collides)


def _digests(stage: Any, parts: list[Part]) -> list[tuple[str, str]]:
    """Returns the paths and content digests of layers and textures."""
    layers = [layer.realPath for layer in stage.GetUsedLayers() if not layer.anonymous]
    textures = sorted({part.surface.texture for part in parts} - {""})
    return [(place, hashlib.sha256(read_asset(place) or b"").hexdigest()) for place in [*layers, *textures]]


def _seen_from(root_layer: Path, place: str) -> str:
    """Returns a path relative to the folder of the root layer; unchanged if USD cannot resolve it."""
    return os.path.relpath(place, root_layer.parent) if Path(place).is_absolute() else place


def _digest_of(lines: list[str]) -> str:
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()
