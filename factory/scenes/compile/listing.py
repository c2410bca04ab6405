"""Finds the usable floor and the spawn points of a scene, and selects its targets: reachable, stable names, tiers.

Adds a note for every candidate that is omitted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from factory.scenes.compile.objects import ShownScene
from factory.scenes.compile.surfaces import target_colour
from factory.scenes.compile.textures import TextureBook
from factory.scenes.importer import Part
from factory.scenes.navigation.floor import find_missing_floor
from factory.scenes.navigation.occupancy import build_occupancy
from factory.scenes.navigation.reach import Terrain, count_reachable, sees_matrix, tiers_of
from factory.scenes.survey.spawn_survey import MIN_SPAWNS, survey_spawns
from factory.scenes.targets.candidates import Candidate, footprint_of
from factory.scenes.targets.target_edits import apply_target_edits, extent_of, recoloured
from factory.scenes.topdown import MapContent, encode_map
from schemas.config import SpawnConfig, TaskConfig
from schemas.errors import WorldError
from schemas.scene import Target
from schemas.support.numpy_types import Floats
from schemas.terms import SuccessMeasure, Tier
from workers.geometry.grid import Grid, separate_floors


@dataclass(frozen=True)
class Reachable:
    """Spawn points, and the targets that are reachable from them."""

    targets: tuple[Target, ...]
    spawns: NDArray[np.float32]
    sees: NDArray[np.uint8]


class UnreachableTargets(WorldError):
    """No target is reachable; contains a map that shows where they are."""

    def __init__(self, message: str, map_png: bytes = b"") -> None:  # the default keeps the error picklable
        super().__init__(message)
        self.map_png = map_png


_LEAST_FLOOR_M2, _MOST_FLOORS = 2.0, 8


def find_terrain(shown: ShownScene, solid: Floats, floor_m: float, notes: list[str]) -> Terrain:
    """Returns the floor that the robot can use: of the separate floors, the one that reaches most candidates.

    Args:
        shown: objects of the scene.
        solid: triangles (T, 3, 3) that the robot can touch, metres.
        floor_m: height of the floor, metres.
        notes: receives a note if another floor is larger.

    Raises:
        WorldError: the grid would be too large, or there is no floor.
    """
    frame, occupancy = build_occupancy(solid, shown.triangles(), floor_m)
    grid = Grid(occupancy, frame.origin_m, frame.resolution_m)
    taken = _taken(shown.candidates, floor_m)
    # the largest floor may be the ground around a closed house
    terrains = [
        Terrain(grid, floor, SpawnConfig(), taken) for floor in separate_floors(grid, _LEAST_FLOOR_M2, _MOST_FLOORS)
    ]
    if len(terrains) == 1 or not shown.candidates:
        return terrains[0]
    targets = [target for target, _ in _candidates_of(shown)]
    reached = [count_reachable(terrain, targets) for terrain in terrains]
    best = reached.index(max(reached))
    if best:
        used, largest = free_area_m2(terrains[best]), free_area_m2(terrains[0])
        notes.append(
            f"the floor of {used} m2 that reaches {reached[best]} of {len(targets)} objects is used, not the largest "
            f"of {largest} m2, which reaches {reached[0]}"
        )
    return terrains[best]


def _taken(candidates: Sequence[Candidate], floor_m: float) -> Floats:
    """Returns the corners x, y (K, 2, 2) of the boxes of candidates whose bottom is below `HIGHEST_BOTTOM_M`."""
    # otherwise, episodes start beneath the boards of shelves, of which only the legs are at the height of the robot
    boxes = [candidate.box for candidate in candidates if candidate.box[0, 2] - floor_m < HIGHEST_BOTTOM_M]
    return np.array([box[:, :2] for box in boxes]).reshape(-1, 2, 2)


def find_reachable(file: str, terrain: Terrain, shown: ShownScene, floor_m: float, notes: list[str]) -> Reachable:
    """Samples spawn points and selects the targets that are reachable from them.

    Args:
        file: file name of the root layer, for messages.
        terrain: floor that the robot can use.
        shown: objects of the scene.
        floor_m: height of the floor, metres.
        notes: notes of the compilation, to which this function adds.

    Raises:
        UnreachableTargets: no target is reachable.
    """
    spawns = survey_spawns(terrain)
    if len(spawns) < MIN_SPAWNS:
        notes.append(f"only {len(spawns)} spawn points fit on {free_area_m2(terrain)} m2 of connected floor")
    points = spawns.astype(np.float64)
    listed = list_targets(
        terrain, shown.candidates, shapes=shown.shapes(), ids=shown.ids, spawns=points, floor_m=floor_m, notes=notes
    )
    targets = apply_target_edits(listed, shown.chosen)
    if not targets:
        shown_map = MapContent.of_terrain(file, terrain, spawns, [target for target, _ in _candidates_of(shown)])
        raise UnreachableTargets(
            _why_no_target(file, shown, terrain, find_missing_floor(shown.triangles(), floor_m) or (notes or [""])[-1]),
            encode_map(shown_map),
        )
    named = with_colours(targets, shown.parts, owners=shown.owners, book=shown.book, uncoloured=shown.uncoloured)
    targets = recoloured(named, shown.chosen)
    return Reachable(targets, spawns, sees_matrix(terrain, points, targets, TaskConfig()))


def _why_no_target(file: str, shown: ShownScene, terrain: Terrain, reason: str) -> str:
    counts = Counter(candidate.category for candidate in shown.candidates)
    if not counts:
        paths = sorted(set(shown.owners))
        return (
            f"{file} has no instance of a known category among {len(paths)} objects (such as {', '.join(paths[:5])}); "
            "name prims after their category, give category rules with --rules, or give the boxes of targets in a file "
            f"with --targets (docs/scenes/own.md; {extent_of(shown.parts)})"
        )
    listed = ", ".join(f"{count} {category}" for category, count in sorted(counts.items()))
    return (
        f"{file} has no reachable target: found {listed}, {free_area_m2(terrain)} m2 of connected floor; "
        f"the robot needs 0.72 m wide passages ({reason})"
    )


def free_area_m2(terrain: Terrain) -> float:
    """Returns the area of the connected floor, square metres."""
    return round(float(terrain.floor.sum()) * terrain.grid.resolution_m**2, 3)


TiersOfPaths = tuple[tuple[Tier, ...], tuple[Tier, ...]]
"""Tiers from which a target is reachable by straight driving, and by any path."""
HIGHEST_BOTTOM_M = 2.0
"""Maximum height of the bottom of a target above the floor, metres."""


def list_targets(
    terrain: Terrain,
    candidates: Sequence[Candidate],
    shapes: Mapping[str, Floats],
    ids: Mapping[str, int],
    spawns: Floats,
    floor_m: float,
    notes: list[str],
) -> tuple[Target, ...]:
    """Returns the candidates that are reachable by any success measure, as targets without colours, in path order.

    The numbers in the names count all candidates of a category, reachable or not, so a target keeps its name when
    another candidate becomes reachable.

    Args:
        terrain: floor of the scene.
        candidates: candidates in the order of their paths.
        shapes: triangles (T, 3, 3) of each candidate by its path, world metres.
        ids: instance ids by path.
        spawns: (S, 2) surveyed points, metres.
        floor_m: height of the floor, metres.
        notes: receives a note for each candidate that is omitted.
    """
    named = _named_targets(candidates, ids, shapes)
    tiers = {success: tiers_of(terrain, [one for one, _ in named], success, spawns) for success in SuccessMeasure}
    by_centroid, by_surface = tiers[SuccessMeasure.CENTROID], tiers[SuccessMeasure.SURFACE]
    targets = []
    for (target, bottom_m), centroid, surface in zip(named, by_centroid, by_surface, strict=True):
        bottom = bottom_m - floor_m
        if not -1.0 < bottom < HIGHEST_BOTTOM_M:
            notes.append(f"{target.target_id}: omitted, it hangs {bottom:.2f} m over the floor ({target.prim_path})")
        elif not (centroid or surface):
            notes.append(f"{target.target_id}: omitted, no pose within its success region fits ({target.prim_path})")
        else:
            targets.append(_with_tiers(target, centroid or ((), ()), surface or ((), ())))
    return tuple(targets)


def _candidates_of(shown: ShownScene) -> list[tuple[Target, float]]:
    return _named_targets(shown.candidates, shown.ids, shown.shapes())


def _named_targets(
    candidates: Sequence[Candidate], ids: Mapping[str, int], shapes: Mapping[str, Floats]
) -> list[tuple[Target, float]]:
    """Returns the candidates as targets, each with the height of its bottom, metres."""
    seen: Counter[str] = Counter()
    named = []
    for candidate in candidates:
        seen[candidate.category] += 1
        name = f"{candidate.category}_{seen[candidate.category]:03d}"
        target = _target(candidate, name, ids[candidate.path], shapes[candidate.path])
        named.append((target, float(candidate.box[0, 2])))
    return named


def _with_tiers(target: Target, centroid: TiersOfPaths, surface: TiersOfPaths) -> Target:
    tiers = {
        "straight_tiers": centroid[0],
        "connected_tiers": centroid[1],
        "surface_straight_tiers": surface[0],
        "surface_connected_tiers": surface[1],
    }
    return target.model_copy(update=tiers)


def _target(candidate: Candidate, name: str, instance_id: int, shape: Floats) -> Target:
    centre, size = candidate.box.mean(axis=0), np.ptp(candidate.box, axis=0)
    return Target(
        target_id=name,
        category=candidate.category,
        instance_id=instance_id,
        prim_path=candidate.path,
        centroid_m=_rounded(centre),
        size_m=_rounded(size),
        footprint_m=footprint_of(shape),
    )


def _rounded(vector: NDArray[np.float64]) -> tuple[float, float, float]:
    """Rounds to tenths of a millimetre, so the result does not depend on the machine."""
    x, y, z = (round(float(value), 4) for value in vector)
    return (x, y, z)


def with_colours(
    targets: Sequence[Target],
    parts: Sequence[Part],
    owners: Sequence[str],
    book: TextureBook,
    uncoloured: frozenset[str] = frozenset(),
) -> tuple[Target, ...]:
    """Returns the targets with the names of their dominant colours, except for uncoloured categories."""
    parts_by_path: dict[str, list[Part]] = {}
    for part, owner in zip(parts, owners, strict=True):
        parts_by_path.setdefault(owner, []).append(part)
    named = []
    for target in targets:
        if target.category in uncoloured:
            named.append(target)
            continue
        named.append(target.model_copy(update={"colour": target_colour(parts_by_path[target.prim_path], book)}))
    return tuple(named)
