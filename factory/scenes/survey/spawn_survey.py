"""Spawn points of a floor, and their measures: number, spacing, floor coverage, visible targets.

Pure and deterministic. Does not sample at random.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from factory.scenes.navigation.reach import Terrain, sees_matrix
from schemas.config import SpawnConfig, TaskConfig
from schemas.scene import CompiledScene
from schemas.support.numpy_types import Floats
from schemas.terms import SuccessMeasure, Tier
from workers.geometry.grid import DISC_RADIUS_M, Grid

MIN_SPAWNS = 40
"""Recommended minimum number of spawn points of a scene (docs/design/scenes.md#surveyed-points)."""
_USUAL, _MANY, _BIG_AREA_M2 = 64, 96, 250.0
_HEADINGS, _MIN_FREE_HEADINGS = 16, 12
"""Number of tested headings, and of headings that must be free."""
# the heading of a far start is drawn at random, so about a quarter of the draws at a point fails at most; with all 16,
# points beside walls and in aisles would be lost
_CLOSEST_M = 0.3


def survey_spawns(terrain: Terrain) -> NDArray[np.float32]:
    """Returns spawn points (S, 2) x, y of the base_link, metres, spread over the connected floor.

    For at least three of four headings, the footprint with the spawn margin is free and on the connected floor. No
    point is within the box of a candidate.
    """
    points = _open_points(terrain)
    area = float(terrain.floor.sum()) * terrain.grid.resolution_m**2
    wanted = _MANY if area > _BIG_AREA_M2 else _USUAL
    if len(points) == 0:
        return np.zeros((0, 2), np.float32)
    return points[_spread(points, terrain.grid.clearance_at(points), wanted)].astype(np.float32)


def _open_points(terrain: Terrain) -> Floats:
    """Returns the centres (N, 2) of cells at which at least 12 of 16 headings fit; tests every second cell."""
    near = terrain.grid.clearance >= DISC_RADIUS_M  # no pose fits in the other cells
    points = terrain.grid.centre_of(2 * np.argwhere(near[::2, ::2]))
    headings = np.zeros(len(points), np.int64)
    for yaw in 2 * np.pi * np.arange(_HEADINGS) / _HEADINGS:
        headings += terrain.can_start(points, yaw)
    return points[headings >= _MIN_FREE_HEADINGS]


def _spread(points: Floats, clearance: Floats, wanted: int) -> NDArray[np.int64]:
    """Farthest-point sampling: starts at the largest clearance, then adds the point farthest from all chosen ones."""
    chosen = [int(clearance.argmax())]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < wanted and distance.max() >= _CLOSEST_M:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


NEAR_M = 2.0
"""Distance from a spawn within which floor counts as covered, metres."""


@dataclass(frozen=True)
class SpawnSight:
    """Spawn point, with the targets that are reachable from it by straight driving."""

    x_m: float
    y_m: float
    targets: int
    categories: tuple[str, ...]


@dataclass(frozen=True)
class SurveyReport:
    """Spawn survey of one scene."""

    success: SuccessMeasure
    """Measure of the distance to the targets."""
    spawns: int
    free_area_m2: float
    nearest_min_m: float
    """Minimum distance between two spawns, metres; 0 with fewer than two."""
    nearest_median_m: float
    """Median distance of a spawn to its nearest neighbour, metres; 0 with fewer than two."""
    within_m: float
    share_within: float
    """Share of the connected floor within `within_m` of a spawn, 0..1."""
    farthest_floor_m: float
    """Maximum distance of a point of the connected floor from its nearest spawn, metres; 0 without spawns."""
    blind: int
    """Number of spawns from which no target is reachable by straight driving."""
    unseen: tuple[str, ...]
    """Ids of the targets that are not reachable by straight driving from any spawn."""
    sights: tuple[SpawnSight, ...]
    shortcomings: tuple[str, ...]
    """Unmet requirements of the scene, each with a remedy; empty if all are met."""


def report_survey(
    scene: CompiledScene, within_m: float = NEAR_M, success: SuccessMeasure = SuccessMeasure.CENTROID
) -> SurveyReport:
    """Measures the spawn points of a scene.

    Args:
        scene: compiled scene.
        within_m: distance from a spawn within which floor counts as covered, metres.
        success: measure of the distance to the targets.

    Raises:
        WorldError: the measure needs footprints, and the package has none.
    """
    spawns, sees = scene.spawns.astype(np.float64), _sees(scene, success)
    apart = cKDTree(spawns).query(spawns, k=2)[0][:, 1] if len(spawns) > 1 else np.zeros(1)
    floor = Grid.from_scene(scene).centre_of(np.argwhere(scene.reachable > 0))
    distance = cKDTree(spawns).query(floor)[0] if len(spawns) and len(floor) else np.full(1, np.inf)
    return SurveyReport(
        success=success,
        spawns=len(spawns),
        free_area_m2=scene.info.free_area_m2,
        nearest_min_m=round(float(apart.min()), 3),
        nearest_median_m=round(float(np.median(apart)), 3),
        within_m=within_m,
        share_within=round(float((distance <= within_m).mean()), 4),
        farthest_floor_m=round(float(distance.max()), 3) if np.isfinite(distance).all() else 0.0,
        blind=int((sees.sum(axis=1) == 0).sum()),
        unseen=_unseen(scene, sees),
        sights=tuple(_sight(scene, sees[row], row) for row in range(len(spawns))),
        shortcomings=_shortcomings(scene),
    )


def _sees(scene: CompiledScene, success: SuccessMeasure) -> NDArray[np.uint8]:
    """Returns (spawns, targets): 1 where a target is reachable by straight driving.

    The package contains the values for distances to the centroid. Those for distances to the surface are computed here.
    """
    if success is SuccessMeasure.CENTROID:
        return scene.spawn_sees
    terrain = Terrain(Grid.from_scene(scene), scene.reachable > 0, SpawnConfig(), np.zeros((0, 2, 2)))
    return sees_matrix(terrain, scene.spawns.astype(np.float64), scene.info.targets, TaskConfig(success=success))


def _unseen(scene: CompiledScene, sees: NDArray[np.uint8]) -> tuple[str, ...]:
    seen = sees.sum(axis=0) > 0
    return tuple(target.target_id for target, is_seen in zip(scene.info.targets, seen, strict=True) if not is_seen)


def _sight(scene: CompiledScene, sees: NDArray[np.uint8], row: int) -> SpawnSight:
    seen = [scene.info.targets[column] for column in np.flatnonzero(sees)]
    x, y = (round(float(value), 3) for value in scene.spawns[row])
    return SpawnSight(x, y, len(seen), tuple(sorted({target.category for target in seen})))


def _shortcomings(scene: CompiledScene) -> tuple[str, ...]:
    shortcomings = []
    if len(scene.spawns) < MIN_SPAWNS:
        shortcomings.append(
            f"only {len(scene.spawns)} of {MIN_SPAWNS} recommended spawn points fit on {scene.info.free_area_m2:g} m2 "
            "of connected floor, because the robot must fit with three of four headings; widen passages beyond "
            "0.72 m, join the floor to one piece or enlarge it"
        )
    by_surface = any(Tier.FAR in target.surface_straight_tiers for target in scene.info.targets)
    if len(scene.spawns) and not (scene.spawn_sees.any() or by_surface):
        shortcomings.append("no start point has a free straight path to a target; clear the floor around the targets")
    return tuple(shortcomings)
