"""Compiles a scene file into a scene package: geometry, appearance, collider, occupancy grid, targets, spawns.

Calls one module per step. The result depends only on the bytes of the stage, the rules and the target list.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from factory.scenes.compile.geometry import Geometry, lay_out_geometry
from factory.scenes.compile.listing import Reachable, find_reachable, find_terrain, free_area_m2
from factory.scenes.compile.objects import instances_of, show_parts
from factory.scenes.compile.overhead import is_open, with_ceiling, with_floor
from factory.scenes.compile.surfaces import triangle_areas
from factory.scenes.compile.surroundings import without_surroundings
from factory.scenes.compile.textures import DrawFunction, TextureBook
from factory.scenes.importer import Extraction, Part
from factory.scenes.light import USUAL_DETAIL, LightDetail
from factory.scenes.limits import USUAL_LIMITS, StageLimits
from factory.scenes.navigation.collider import solid_triangles, weld
from factory.scenes.navigation.floor import find_floor_height, find_missing_floor
from factory.scenes.navigation.reach import Terrain
from factory.scenes.rules import RuleBook, builtin_rules
from factory.scenes.targets.target_edits import cut_boxes
from factory.scenes.targets.target_list import TargetList
from factory.scenes.version import COMPILER_VERSION
from schemas.errors import WorldError
from schemas.scene import CompiledScene, SceneInfo, Sky
from schemas.support.numpy_types import Floats

_SANE_RADIUS_M = 200.0
_SANE_SPREAD = 5.0
"""A part is omitted if it is farther from the median of all parts than the radius, and than the spread times the median
distance."""
# in a site with evenly distributed parts, no part is farther than twice the median distance, so large sites keep their
# outskirts. A test omits a book 344 km above its room
_FARTHEST_M = 9000.0
_NO_AREA_M2 = 1e-14
_MAX_NOTES = 200


def compile_stage(
    path: Path,
    name: str,
    source: str,
    rules: RuleBook | None = None,
    chosen: TargetList | None = None,
    limits: StageLimits = USUAL_LIMITS,
    has_materials: bool = True,
) -> CompiledScene:
    """Compiles a scene file.

    Args:
        path: root file of the scene.
        name: name of the scene.
        source: origin of the stage, recorded in the package.
        rules: category rules; the built-in table when `None`.
        chosen: target list of the user; all targets that the rules find when `None`.
        limits: limits of the import.
        has_materials: whether to record the materials of objects.

    Raises:
        UsageError: the file does not exist, or `chosen` names prims that the stage does not have.
        WorldError: the file is not a stage, or the stage has no visible mesh, no floor or no reachable target.
    """
    # imports OpenUSD and readers of other formats, which layouts do not need
    from factory.scenes.formats import extract_scene

    content = extract_scene(path, limits)
    return compile_extraction(
        path.name, content, name=name, source=source, rules=rules, chosen=chosen, has_materials=has_materials
    )


def compile_extraction(
    file: str,
    extraction: Extraction,
    name: str,
    source: str,
    rules: RuleBook | None = None,
    chosen: TargetList | None = None,
    detail: LightDetail = USUAL_DETAIL,
    required: Collection[str] = (),
    has_materials: bool = True,
    draw: DrawFunction | None = None,
) -> CompiledScene:
    """Compiles an extracted stage.

    Args:
        file: file name of the root layer, for messages.
        extraction: visible and collision geometry of the stage.
        name: name of the scene.
        source: origin of the stage, recorded in the package.
        rules: category rules; the built-in table when `None`.
        chosen: target list of the user; all targets that the rules find when `None`.
        detail: resolution of the light map, and number of rays.
        required: categories that must have a reachable target; checked before the light is computed.
        has_materials: whether to record the materials of objects.
        draw: function that returns the pixels of the textures of an authored scene.

    Raises:
        UsageError: `chosen` names prims that the stage does not have.
        WorldError: the stage has no visible mesh, no floor, no reachable target or none of a required category.
    """
    rules = rules or builtin_rules()
    notes = list(extraction.notes)
    parts, has_sky = without_surroundings(_without_outliers(file, extraction, notes), notes)
    parts = with_floor(cut_boxes(parts, chosen), extraction.floor_m, notes)
    parts = with_ceiling(parts, extraction.ceiling_m)
    shown = show_parts(
        file, extraction, parts=parts, selection=(rules, chosen), has_materials=has_materials, notes=notes, draw=draw
    )
    with _sizes_in_errors(file, extraction, shown.parts):
        floor_m = find_floor_height(shown.triangles())
        missing = find_missing_floor(shown.triangles(), floor_m)
        notes += [missing] if missing else []
        colliders = [part for part in parts if part.is_collider]
        solid = solid_triangles([part for part in parts if not part.is_collider], colliders, floor_m)
        terrain = find_terrain(shown, solid, floor_m, notes)
    survey = find_reachable(file, terrain, shown=shown, floor_m=floor_m, notes=notes)
    _require_categories(required, survey)
    geometry = lay_out_geometry(
        shown.parts, shown.owners, ids=shown.ids, book=shown.book, floor_m=floor_m, notes=notes, detail=detail
    )
    info = SceneInfo(
        name=name,
        source=source,
        source_sha256=_digest(extraction, rules, chosen),
        metres_per_unit=extraction.metres_per_unit,
        bounds_m=_bounds(shown.triangles()),
        grid_origin_m=terrain.grid.origin_m,
        grid_resolution_m=terrain.grid.resolution_m,
        targets=survey.targets,
        instances=instances_of(shown),
        texture_count=len(shown.book.layers),
        floor_height_m=floor_m,
        free_area_m2=free_area_m2(terrain),
        notes=_shortened(notes),
        sky=Sky() if has_sky or is_open(shown.triangles(), survey.spawns, floor_m) else None,
    )
    return _assemble(info, shown.book, geometry=geometry, collider=weld(solid), terrain=terrain, survey=survey)


def _require_categories(required: Collection[str], survey: Reachable) -> None:
    if missing := sorted(set(required) - {target.category for target in survey.targets}):
        raise WorldError(f"no reachable {', '.join(missing)}; use another seed")


def _without_outliers(file: str, extraction: Extraction, notes: list[str]) -> tuple[Part, ...]:
    """Drops parts that are implausibly far from the others, because they would inflate the bounds and the grid."""
    parts = [part for part in extraction.parts if len(part.triangles)]
    parts = _with_area(parts, notes)
    if not any(not part.is_collider for part in parts):
        noted = "; ".join(extraction.notes[-4:])
        raise WorldError(
            f"{file} contains no visible mesh ({noted}); check payloads, references, visibility and purpose"
        )
    middles = np.array([part.triangles.mean(axis=(0, 1)) for part in parts])
    centre = np.median(middles, axis=0)
    if np.abs(centre).max() > _FARTHEST_M:
        x, y, z = centre
        raise WorldError(
            f"{file} is far from the origin, around ({x:.0f}, {y:.0f}, {z:.0f}) m; move it near the origin of its stage"
        )
    off = np.abs(middles - centre).max(axis=1)
    limit = max(_SANE_RADIUS_M, _SANE_SPREAD * float(np.median(off)))
    for part, distance in zip(parts, off, strict=True):
        if distance > limit:
            notes.append(f"{part.path}: omitted, {distance:.0f} m away from everything else")
    kept = [part for part, distance in zip(parts, off, strict=True) if distance <= limit]
    return tuple(sorted(kept, key=lambda part: part.path))


def _with_area(parts: list[Part], notes: list[str]) -> list[Part]:
    """Drops parts of which no triangle has an area, with a note."""
    flat = [part for part in parts if triangle_areas(part.triangles).max() <= _NO_AREA_M2]
    notes += [f"{part.path}: ignored, its {len(part.triangles)} faces have no area" for part in flat]
    empty = {id(part) for part in flat}
    return [part for part in parts if id(part) not in empty]


@contextmanager
def _sizes_in_errors(file: str, extraction: Extraction, parts: Sequence[Part]) -> Iterator[None]:
    """Adds the unit of the scene and the size of its widest prim to an error, so a wrong unit is visible."""
    try:
        yield
    except WorldError as error:
        sizes = [np.ptp(part.triangles.reshape(-1, 3), axis=0) for part in parts]
        widest = int(np.argmax([size[:2].max() for size in sizes]))
        x, y, z = sizes[widest]
        unit = f"unit {extraction.metres_per_unit:g} m"
        raise WorldError(
            f"{file}, {unit}, widest prim {parts[widest].path} ({x:.4g} x {y:.4g} x {z:.4g} m): {error}"
        ) from error


def _digest(extraction: Extraction, rules: RuleBook, chosen: TargetList | None) -> str:
    text = f"{extraction.sha256}\n{rules.model_dump_json()}\ncompiler {COMPILER_VERSION}"
    text += "" if chosen is None else f"\n{chosen.digest}"
    return hashlib.sha256(text.encode()).hexdigest()


def _bounds(triangles: Floats) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    corners = triangles.reshape(-1, 3)
    low, high = ([round(float(value), 4) for value in corner] for corner in (corners.min(axis=0), corners.max(axis=0)))
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])


def _shortened(notes: Sequence[str]) -> tuple[str, ...]:
    unique = tuple(dict.fromkeys(notes))
    if len(unique) <= _MAX_NOTES:
        return unique
    return (*unique[:_MAX_NOTES], f"and {len(unique) - _MAX_NOTES} notes more")


def _assemble(
    info: SceneInfo,
    book: TextureBook,
    geometry: Geometry,
    collider: tuple[NDArray[np.float32], NDArray[np.int32]],
    terrain: Terrain,
    survey: Reachable,
) -> CompiledScene:
    return CompiledScene(
        info=info,
        **{field.name: getattr(geometry, field.name) for field in fields(geometry)},
        textures=book.layers,
        masks=book.masks,
        collider_vertices=collider[0],
        collider_triangles=collider[1],
        occupancy=terrain.grid.occupancy,
        reachable=terrain.floor.astype(np.uint8),
        spawns=survey.spawns,
        spawn_sees=survey.sees,
    )
