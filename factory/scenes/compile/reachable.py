"""Finds the floor of a scene that the robot can use, its spawn points, and the targets that are reachable from them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from factory.scenes.compile.listing import HIGHEST_BOTTOM_M, list_targets, with_colours
from factory.scenes.compile.shown import ShownScene
from factory.scenes.navigation.occupancy import build_occupancy
from factory.scenes.navigation.reach import Terrain, sees_matrix
from factory.scenes.survey.spawns import MIN_SPAWNS, survey_spawns
from factory.scenes.targets.candidates import Candidate
from factory.scenes.targets.target_edits import apply_target_edits, recoloured
from schemas.config import SpawnConfig, TaskConfig
from schemas.errors import WorldError
from schemas.scene import Target
from schemas.support.numpy_types import Floats
from workers.geometry.grid import Grid


@dataclass(frozen=True)
class Reachable:
    """Spawn points, and the targets that are reachable from them."""

    targets: tuple[Target, ...]
    spawns: NDArray[np.float32]
    sees: NDArray[np.uint8]


def find_terrain(shown: ShownScene, solid: Floats, floor_m: float) -> Terrain:
    """Returns the floor that the robot can use.

    Args:
        shown: objects of the scene.
        solid: triangles (T, 3, 3) that the robot can touch, metres.
        floor_m: height of the floor, metres.

    Raises:
        WorldError: the grid would be too large, or there is no floor.
    """
    frame, occupancy = build_occupancy(solid, shown.triangles(), floor_m)
    grid = Grid(occupancy, frame.origin_m, frame.resolution_m)
    return Terrain(grid, grid.connected_floor(), SpawnConfig(), _taken(shown.candidates, floor_m))


def _taken(candidates: Sequence[Candidate], floor_m: float) -> Floats:
    """Returns the corners x, y (K, 2, 2) of the boxes of candidates whose bottom is below `HIGHEST_BOTTOM_M`."""
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
        WorldError: no target is reachable.
    """
    spawns = survey_spawns(terrain)
    if len(spawns) < MIN_SPAWNS:
        notes.append(f"only {len(spawns)} spawn points fit on {free_area_m2(terrain)} m2 of connected floor")
    points = spawns.astype(np.float64)
    listed = list_targets(terrain, shown.candidates, shown.shapes(), shown.ids, points, floor_m, notes)
    targets = apply_target_edits(listed, shown.chosen)
    if not targets:
        raise WorldError(_why_no_target(file, shown, terrain, notes))
    named = with_colours(targets, shown.parts, shown.owners, shown.book, shown.uncoloured)
    targets = recoloured(named, shown.chosen)
    return Reachable(targets, spawns, sees_matrix(terrain, points, targets, TaskConfig()))


def _why_no_target(file: str, shown: ShownScene, terrain: Terrain, notes: list[str]) -> str:
    counts = Counter(candidate.category for candidate in shown.candidates)
    if not counts:
        paths = sorted(set(shown.owners))
        return (
            f"{file} has no instance of a known category among {len(paths)} objects (such as {', '.join(paths[:5])}); "
            "name prims after their category or give category rules with --rules"
        )
    found = ", ".join(f"{count} {category}" for category, count in sorted(counts.items()))
    return (
        f"{file} has no reachable target: found {found}, {free_area_m2(terrain)} m2 of connected floor; "
        f"the robot needs 0.72 m wide passages; --floor M adds a floor to a file without one ({notes[-1]})"
    )


def free_area_m2(terrain: Terrain) -> float:
    """Returns the area of the connected floor, square metres."""
    return round(float(terrain.floor.sum()) * terrain.grid.resolution_m**2, 3)
