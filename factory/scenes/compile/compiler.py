"""Compiles a scene file into a scene package: geometry, appearance, collider, occupancy grid, targets, spawns.

Calls one module per step. The result depends only on the bytes of the stage, the rules and the target list.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from factory.scenes.compile.geometry import Geometry, lay_out_geometry
from factory.scenes.compile.listing import HIGHEST_BOTTOM_M, list_targets, with_colours
from factory.scenes.compile.object_materials import materials_of
from factory.scenes.compile.objects import assign_objects, number_objects
from factory.scenes.compile.overhead import is_open, with_ceiling, with_floor
from factory.scenes.compile.shade import target_colour, triangle_areas
from factory.scenes.compile.textures import DrawFunction, TextureBook, load_textures
from factory.scenes.importer import Extraction, Part, TextureRecipe
from factory.scenes.light import USUAL_DETAIL, LightDetail
from factory.scenes.limits import USUAL_LIMITS, StageLimits
from factory.scenes.navigation.collider import solid_triangles, weld
from factory.scenes.navigation.floor import find_floor_height
from factory.scenes.navigation.occupancy import build_occupancy
from factory.scenes.navigation.reach import Terrain, sees_matrix
from factory.scenes.rules import RuleBook, builtin_rules
from factory.scenes.survey.spawns import MIN_SPAWNS, survey_spawns
from factory.scenes.targets.candidates import Candidate, find_candidates
from factory.scenes.targets.target_edits import apply_candidate_edits, apply_target_edits, recoloured
from factory.scenes.targets.target_list import TargetList
from factory.scenes.version import COMPILER_VERSION
from schemas.config import SpawnConfig, TaskConfig
from schemas.errors import WorldError
from schemas.scene import CompiledScene, Instance, SceneInfo, Sky, Target
from schemas.support.numpy_types import Floats
from workers.geometry.grid import Grid

_SANE_RADIUS_M = 200.0
_SANE_SPREAD = 5.0
_FARTHEST_M = 9000.0
_SEE_THROUGH = 0.3
_MAX_NOTES = 200


@dataclass(frozen=True)
class _Shown:
    """Visible parts, and the object that each belongs to."""

    parts: tuple[Part, ...]
    candidates: tuple[Candidate, ...]
    owners: tuple[str, ...]
    ids: dict[str, int]
    book: TextureBook
    chosen: TargetList | None
    """Target list of the user, if given."""
    uncoloured: frozenset[str]
    """Categories whose colour is never named."""
    has_materials: bool
    """Whether materials are recorded."""

    def triangles(self) -> Floats:
        """Returns all triangles (T, 3, 3), world metres."""
        return np.concatenate([part.triangles for part in self.parts])

    def shapes(self) -> dict[str, Floats]:
        """Returns the triangles (T, 3, 3) of each object by its path, world metres."""
        groups: dict[str, list[Floats]] = {}
        for part, owner in zip(self.parts, self.owners, strict=True):
            groups.setdefault(owner, []).append(part.triangles)
        return {owner: np.concatenate(triangles) for owner, triangles in groups.items()}


@dataclass(frozen=True)
class _Survey:
    """Spawn points, and the targets that are reachable from them."""

    targets: tuple[Target, ...]
    spawns: NDArray[np.float32]
    sees: NDArray[np.uint8]


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
    from factory.scenes.formats import extract_scene  # OpenUSD and readers of other formats, which layouts do not need

    content = extract_scene(path, limits)
    return compile_extraction(path.name, content, name, source, rules, chosen, has_materials=has_materials)


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
    parts = with_floor(_without_outliers(file, extraction, notes), extraction.floor_m)
    parts = with_ceiling(parts, extraction.ceiling_m)
    shown = _show(file, extraction, parts, (rules, chosen), has_materials, notes, draw)
    with _sizes_in_errors(file, extraction, shown.parts):
        floor_m = find_floor_height(shown.triangles())
        solid = solid_triangles(
            [part for part in parts if not part.is_collider], [part for part in parts if part.is_collider], floor_m
        )
        frame, occupancy = build_occupancy(solid, shown.triangles(), floor_m)
    grid = Grid(occupancy, frame.origin_m, frame.resolution_m)
    terrain = Terrain(grid, grid.connected_floor(), SpawnConfig(), _taken(shown.candidates, floor_m))
    survey = _survey(file, terrain, shown, floor_m, notes)
    if missing := sorted(set(required) - {target.category for target in survey.targets}):
        raise WorldError(f"no reachable {', '.join(missing)}; use another seed")
    geometry = lay_out_geometry(shown.parts, shown.owners, shown.ids, shown.book, floor_m, notes, detail)
    info = SceneInfo(
        name=name,
        source=source,
        source_sha256=_digest(extraction, rules, chosen),
        metres_per_unit=extraction.metres_per_unit,
        bounds_m=_bounds(shown.triangles()),
        grid_origin_m=frame.origin_m,
        grid_resolution_m=frame.resolution_m,
        targets=survey.targets,
        instances=_instances(shown),
        texture_count=len(shown.book.layers),
        floor_height_m=floor_m,
        free_area_m2=_area(terrain),
        notes=_shortened(notes),
        sky=Sky() if is_open(shown.triangles(), survey.spawns, floor_m) else None,
    )
    return _assemble(info, shown.book, geometry, weld(solid), terrain, survey)


def _without_outliers(file: str, extraction: Extraction, notes: list[str]) -> tuple[Part, ...]:
    """Drops parts that are implausibly far from the others, because they would inflate the bounds and the grid."""
    parts = [part for part in extraction.parts if len(part.triangles)]
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


def _show(
    file: str,
    extraction: Extraction,
    parts: Sequence[Part],
    wishes: tuple[RuleBook, TargetList | None],
    has_materials: bool,
    notes: list[str],
    draw: DrawFunction | None,
) -> _Shown:
    visible = tuple(part for part in parts if not part.is_collider and part.surface.opacity >= _SEE_THROUGH)
    clear = sum(not part.is_collider for part in parts) - len(visible)
    if clear:
        notes.append(f"{clear} transparent parts are not rendered, but the robot cannot pass them")
    if not visible:
        raise WorldError(f"{file} contains no visible mesh except {clear} transparent ones; check their opacity")
    rules, chosen = wishes
    users = {part.surface.texture: part.path for part in reversed(visible)}
    book = load_textures(_texture_areas(visible), partial(_read_texture, extraction), users, draw)
    notes += book.notes
    found = find_candidates(extraction, visible, rules, lambda own: target_colour(own, book))
    candidates = apply_candidate_edits(found, visible, chosen)
    owners = assign_objects(visible, [candidate.path for candidate in candidates], extraction.models)
    ids = number_objects(owners)
    return _Shown(visible, candidates, owners, ids, book, chosen, rules.uncoloured, has_materials)


def _read_texture(extraction: Extraction, name: str) -> bytes | TextureRecipe | None:
    """Returns a texture of the content, or else of a file."""
    if name in extraction.images:
        return extraction.images[name]
    from factory.scenes.importer.assets import read_asset  # OpenUSD

    return read_asset(name)


@contextmanager
def _sizes_in_errors(file: str, extraction: Extraction, parts: Sequence[Part]) -> Iterator[None]:
    """Adds the unit of the scene and the size of its widest prim to an error, so that a wrong unit is visible."""
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


def _texture_areas(parts: Sequence[Part]) -> dict[str, float]:
    areas: dict[str, float] = {}
    for part in parts:
        if part.surface.texture:
            known = areas.get(part.surface.texture, 0.0)
            areas[part.surface.texture] = known + float(triangle_areas(part.triangles).sum())
    return areas


def _survey(file: str, terrain: Terrain, shown: _Shown, floor_m: float, notes: list[str]) -> _Survey:
    spawns = survey_spawns(terrain)
    if len(spawns) < MIN_SPAWNS:
        notes.append(f"only {len(spawns)} spawn points fit on {_area(terrain)} m2 of connected floor")
    points = spawns.astype(np.float64)
    listed = list_targets(terrain, shown.candidates, shown.shapes(), shown.ids, points, floor_m, notes)
    targets = apply_target_edits(listed, shown.chosen)
    if not targets:
        raise WorldError(_why_no_target(file, shown, terrain, notes))
    named = with_colours(targets, shown.parts, shown.owners, shown.book, shown.uncoloured)
    targets = recoloured(named, shown.chosen)
    return _Survey(targets, spawns, sees_matrix(terrain, points, targets, TaskConfig()))


def _taken(candidates: Sequence[Candidate], floor_m: float) -> Floats:
    """Returns the lower and upper corners x, y (K, 2, 2) of the candidates' boxes, without those that hang high."""
    boxes = [candidate.box for candidate in candidates if candidate.box[0, 2] - floor_m < HIGHEST_BOTTOM_M]
    return np.array([box[:, :2] for box in boxes]).reshape(-1, 2, 2)


def _why_no_target(file: str, shown: _Shown, terrain: Terrain, notes: list[str]) -> str:
    counts = Counter(candidate.category for candidate in shown.candidates)
    if not counts:
        paths = sorted(set(shown.owners))
        return (
            f"{file} has no instance of a known category among {len(paths)} objects (such as {', '.join(paths[:5])}); "
            "name prims after their category or give category rules with --rules"
        )
    found = ", ".join(f"{count} {category}" for category, count in sorted(counts.items()))
    return (
        f"{file} has no reachable target: found {found}, {_area(terrain)} m2 of connected floor; "
        f"the robot needs 0.72 m wide passages; --floor M adds a floor to a file without one ({notes[-1]})"
    )


def _area(terrain: Terrain) -> float:
    return round(float(terrain.floor.sum()) * terrain.grid.resolution_m**2, 3)


def _digest(extraction: Extraction, rules: RuleBook, chosen: TargetList | None) -> str:
    text = f"{extraction.sha256}\n{rules.model_dump_json()}\ncompiler {COMPILER_VERSION}"
    text += "" if chosen is None else f"\n{chosen.digest}"
    return hashlib.sha256(text.encode()).hexdigest()


def _bounds(triangles: Floats) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    corners = triangles.reshape(-1, 3)
    low, high = ([round(float(value), 4) for value in corner] for corner in (corners.min(axis=0), corners.max(axis=0)))
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])


def _instances(shown: _Shown) -> tuple[Instance, ...]:
    categories = {candidate.path: candidate.category for candidate in shown.candidates}
    materials = materials_of(shown.parts, shown.owners) if shown.has_materials else {}
    return tuple(
        Instance(id=number, prim_path=path, category=categories.get(path), materials=materials.get(path, ()))
        for path, number in shown.ids.items()
    )


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
    survey: _Survey,
) -> CompiledScene:
    return CompiledScene(
        info=info,
        **{field.name: getattr(geometry, field.name) for field in fields(geometry)},
        textures=book.layers,
        collider_vertices=collider[0],
        collider_triangles=collider[1],
        occupancy=terrain.grid.occupancy,
        reachable=terrain.floor.astype(np.uint8),
        spawns=survey.spawns,
        spawn_sees=survey.sees,
    )
