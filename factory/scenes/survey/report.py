"""Measures the spawn points of a compiled scene: number, spacing, floor coverage, visible targets.

Pure functions. Does not compute spawn points; `spawns.py` does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from factory.scenes.navigation.reach import Terrain, sees_matrix
from factory.scenes.survey.spawns import MIN_SPAWNS
from schemas.config import SpawnConfig, TaskConfig
from schemas.scene import CompiledScene
from schemas.terms import SuccessMeasure, Tier
from workers.geometry.grid import Grid

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
    found = []
    if len(scene.spawns) < MIN_SPAWNS:
        found.append(
            f"only {len(scene.spawns)} of {MIN_SPAWNS} recommended spawn points fit on {scene.info.free_area_m2:g} m2 "
            "of connected floor, because the robot must fit with three of four headings; widen passages beyond "
            "0.72 m, join the floor to one piece or enlarge it"
        )
    by_surface = any(Tier.FAR in target.surface_straight_tiers for target in scene.info.targets)
    if len(scene.spawns) and not (scene.spawn_sees.any() or by_surface):
        found.append("no start point has a free straight path to a target; clear the floor around the targets")
    return tuple(found)
