"""Measures how much the layouts of a family differ: distributions of their properties, and distances between them.

Works on floor plans and compiled scenes. Does not build scenes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations

import numpy as np

from factory.scenes.author.placement import FloorPlan
from schemas.config import TaskConfig
from schemas.scene import CompiledScene
from schemas.support.numpy_types import Bools
from schemas.terms import SuccessMeasure
from workers.geometry.grid import OCCUPIED, Grid
from workers.planning import geodesic_m

_COARSE = 4
"""Two maps are compared in coarse cells. Side of a coarse cell, in cells of the occupancy grid: 4 x 0.05 m = 0.2 m."""
_STARTS, _GOALS = 4, 12
"""Largest number of starts and of targets of a layout between which path lengths are measured."""


@dataclass(frozen=True)
class LayoutFacts:
    """Properties of one layout."""

    seed: int
    """Seed of the layout."""
    rooms: int
    """Number of rooms; 1 for a layout that records none."""
    area_m2: float
    """Extent of the building, square metres."""
    free_area_m2: float
    """Floor that the robot can occupy, square metres."""
    loops: int
    """Independent loops of the room graph; 0 for a tree."""
    widest_degree: int
    """Largest number of openings of a room."""
    categories: int
    """Number of categories with a target."""
    targets: int
    """Number of targets."""
    clutter: float
    """Objects per 10 square metres of the building."""
    path_m: float
    """Median path length along the floor between sampled starts and targets, metres."""
    visible: float
    """Median number of targets that a start point sees and reaches on a straight line."""


@dataclass(frozen=True)
class Distribution:
    """Distribution of one property over layouts."""

    least: float
    """Smallest value."""
    median: float
    """Median."""
    greatest: float
    """Largest value."""
    deviation: float
    """Standard deviation."""


def measure_layout(seed: int, plan: FloorPlan, scene: CompiledScene) -> LayoutFacts:
    (west, south, _), (east, north, _) = scene.info.bounds_m
    area = (east - west) * (north - south)
    degrees = [len(room.neighbours) for room in plan.rooms] or [0]
    visible = scene.spawn_sees.sum(axis=1) if len(scene.spawns) else np.zeros(1)
    return LayoutFacts(
        seed=seed,
        rooms=max(1, len(plan.rooms)),
        area_m2=round(area, 1),
        free_area_m2=round(scene.info.free_area_m2, 1),
        loops=max(0, sum(degrees) // 2 - len(degrees) + 1),
        widest_degree=max(degrees),
        categories=len({target.category for target in scene.info.targets}),
        targets=len(scene.info.targets),
        clutter=round(10 * len(plan.placements) / area, 2),
        path_m=round(_median_path(scene), 2),
        visible=float(np.median(visible)),
    )


def _median_path(scene: CompiledScene) -> float:
    """Returns the median path length between evenly chosen starts and targets, metres."""
    grid, task = Grid.from_scene(scene), TaskConfig(success=SuccessMeasure.SURFACE)
    starts = scene.spawns[:: max(1, len(scene.spawns) // _STARTS)][:_STARTS].astype(float)
    goals = scene.info.targets[:: max(1, len(scene.info.targets) // _GOALS)][:_GOALS]
    lengths = [geodesic_m(grid, start, goal, task) for goal in goals for start in starts]
    known = [length for length in lengths if length is not None]
    return float(np.median(known)) if known else 0.0


def spreads(layouts: Sequence[LayoutFacts]) -> dict[str, Distribution]:
    """Returns the distribution of every property; empty without layouts."""
    if not layouts:
        return {}
    table = {name: np.array([asdict(facts)[name] for facts in layouts], float) for name in asdict(layouts[0])}
    del table["seed"]
    return {
        name: Distribution(*(round(float(v), 3) for v in (x.min(), np.median(x), x.max(), x.std())))
        for name, x in table.items()
    }


def coarse_map(scene: CompiledScene) -> Bools:
    """Returns a map of a layout without empty margins: cells of 0.2 m, true if at least half of a cell is occupied."""
    occupied = scene.occupancy == OCCUPIED
    rows, columns = np.nonzero(occupied)
    cut = occupied[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    padded = np.pad(cut, [(0, -size % _COARSE) for size in cut.shape])
    blocks = padded.reshape(padded.shape[0] // _COARSE, _COARSE, padded.shape[1] // _COARSE, _COARSE)
    return np.asarray(blocks.mean(axis=(1, 3)) >= 0.5)


def map_distance(one: Bools, two: Bools) -> float:
    """Returns the share of occupied cells that two maps do not have in common, 0..1.

    The corners of the maps are aligned. The smallest share over the eight rotations and reflections is returned.
    """
    turned = [np.rot90(mirrored, turn) for mirrored in (two, two[:, ::-1]) for turn in range(4)]
    return min(_jaccard(one, other) for other in turned)


def _jaccard(one: Bools, two: Bools) -> float:
    shape = np.maximum(one.shape, two.shape)
    first, second = (np.pad(each, [(0, int(size - length)) for size, length in zip(shape, each.shape, strict=True)])
                     for each in (one, two))  # fmt: skip
    union = int((first | second).sum())
    return 1.0 - int((first & second).sum()) / union if union else 0.0


def nearest_neighbours(maps: Mapping[int, Bools]) -> dict[int, tuple[int, float]]:
    """Returns, by the seed of each layout, the seed of the most similar other layout, and their distance."""
    nearest: dict[int, tuple[int, float]] = {}
    for one, two in combinations(sorted(maps), 2):
        distance = map_distance(maps[one], maps[two])
        for pair, other in ((one, two), (two, one)):
            if pair not in nearest or distance < nearest[pair][1]:
                nearest[pair] = (other, round(distance, 4))
    return nearest
