"""Computes success regions, which targets the robot can reach, and from which tiers: straight or by any path.

Pure and deterministic: tests lattices of poses on the occupancy grid. Does not simulate and does not sample.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from schemas.config import SpawnConfig, TaskConfig
from schemas.measure import Goal
from schemas.scene import Target
from schemas.support.approach import approach, ring, target_distances
from schemas.support.numpy_types import Bools, Floats
from schemas.terms import FAR_FLOOR_M, TIER_RANGE_M, SuccessMeasure, Tier
from workers.geometry.grid import Grid, are_within, body_centre

_AT_ONCE = 32
"""Number of targets whose arrays are computed together; these arrays fit the processor cache."""

Rows = NDArray[np.intp]


@dataclass(frozen=True)
class Goals:
    """Success regions of T targets by one measure; the results equal those of each `Goal`, bit for bit."""

    centres: Floats
    """(T, 2) centroids, metres."""
    reaches: Floats
    """(T, 2) half the extents of the targets' boxes, metres."""
    extents: Floats
    """(T,) largest distance of a vertex from the centroid, metres."""
    vertices: Floats | None
    """(K, T, 2) vertices of the footprints, metres, padded with the last vertex; `None` for the centroid measure."""

    @classmethod
    def of(cls, targets: Sequence[Target], goals: Sequence[Goal]) -> Goals:
        """Returns the goals of targets, all by the same measure."""
        most = max((len(goal.footprint_m) for goal in goals), default=0)
        padded = [(*goal.footprint_m, *goal.footprint_m[-1:] * (most - len(goal.footprint_m))) for goal in goals]
        return cls(
            centres=np.array([goal.centre_m for goal in goals]).reshape(-1, 2),
            reaches=np.array([target.size_m[:2] for target in targets]).reshape(-1, 2) / 2,
            extents=np.array([goal.extent_m for goal in goals]),
            vertices=np.array(padded).transpose(1, 0, 2) if most else None,
        )

    def chosen(self, rows: Rows) -> Goals:
        """Returns the goals at the given indices, one for each index."""
        vertices = None if self.vertices is None else self.vertices[:, rows]
        return Goals(self.centres[rows], self.reaches[rows], self.extents[rows], vertices)

    def ring(self, directions: Floats, distance_m: float) -> Floats:
        """Returns the points (T, N, 2) at a distance from each target, on rays with directions (N, 2)."""
        vertices = None if self.vertices is None else self.vertices[:, :, None]
        return ring(directions, np.asarray(distance_m), self.centres[:, None], self.extents[:, None], vertices)

    def approach(self, starts: Floats, distance_m: float) -> Floats:
        """Returns the points (T, 2) at which the line from each start to its target comes within a distance of it."""
        return approach(starts, np.asarray(distance_m), self.centres, self.vertices)

    def distances(self, points: Floats) -> Floats:
        """Returns the distances (T, N) of points (N, 2) to each target, metres."""
        vertices = None if self.vertices is None else self.vertices[:, :, None]
        spread = np.broadcast_to(points, (len(self.centres), *points.shape))
        return target_distances(spread, self.centres[:, None], vertices)


def batches(goals: Sequence[Goal]) -> Iterator[Rows]:
    """Yields the indices of all goals in batches; the goals of a batch have similar numbers of vertices."""
    order = np.argsort([len(goal.footprint_m) for goal in goals], kind="stable")
    for first in range(0, len(order), _AT_ONCE):
        yield order[first : first + _AT_ONCE]


ARRIVAL_RADIUS_M = 0.97
"""Distance from the target at which the robot stops within the success region, by the success measure, metres."""
SEE_RANGE_M = (1.5, 11.0)
"""Range of distances from a target; a spawn point outside this range does not count as seeing the target, metres."""
MIN_STARTS = 3
"""A target counts as reachable from the tier near or mid only if it has at least this number of valid lattice poses,
so random sampling finds one."""
_ARRIVAL_SHARES = (1.0, 0.85, 0.7, 0.5, 0.3)
_BEARINGS, _HEADINGS, _RINGS = 48, 16, 6


@dataclass(frozen=True)
class Terrain:
    """Occupancy grid with the connected floor and the boxes of candidates."""

    grid: Grid
    floor: Bools
    """(H, W) cells that the body centre can reach."""
    config: SpawnConfig
    taken: Floats
    """(K, 2, 2) lower and upper corners x, y of the candidates' boxes, metres."""

    def fits(self, x: ArrayLike, y: ArrayLike, yaw: ArrayLike, margin_m: float) -> Bools:
        """Returns whether, at each base_link pose, the footprint is free and the body centre on the connected floor."""
        on_floor = self.grid.values_at(self.floor, body_centre(x, y, yaw), False)
        return np.asarray(on_floor.astype(bool) & self.grid.are_poses_free(x, y, yaw, margin_m))

    def can_start(self, points: Floats, yaw: ArrayLike) -> Bools:
        """Returns whether the robot can start at each base_link point (N, 2): it fits with the spawn margin, and the
        point is outside all boxes."""
        fits = self.fits(points[:, 0], points[:, 1], yaw, self.config.margin_m)
        return np.asarray(fits & ~are_within(points, self.taken))


def tiers_of(
    terrain: Terrain, targets: Sequence[Target], success: SuccessMeasure, spawns: Floats
) -> list[tuple[tuple[Tier, ...], tuple[Tier, ...]] | None]:
    """Returns the tiers from which each target is reachable: by straight driving, and by any path. Returns `None` for a
    target that is not reachable.

    Args:
        terrain: floor of the scene.
        targets: targets to reach.
        success: measure of the success region and of the distances of the tiers.
        spawns: (S, 2) surveyed points, metres.
    """
    goals = [Goal.of(target, TaskConfig(success=success)) for target in targets]
    tiers: list[tuple[tuple[Tier, ...], tuple[Tier, ...]] | None] = [None] * len(targets)
    for batch in batches(goals):
        every = Goals.of([targets[row] for row in batch], [goals[row] for row in batch])
        rows = np.flatnonzero(_are_reachable(terrain, every))
        reachable = every.chosen(rows)
        straight, connected = _ring_tiers(terrain, reachable)
        # tests the straight distance; the path along the floor is at least as long
        is_far = reachable.distances(spawns) >= FAR_FLOOR_M[0]
        straight[Tier.FAR] = np.asarray(_see(terrain, spawns, reachable, is_far).any(axis=1))
        connected[Tier.FAR] = np.asarray(is_far.any(axis=1))
        for place, row in enumerate(batch[rows].tolist()):
            tiers[row] = _chosen(straight, place), _chosen(connected, place)
    return tiers


def count_reachable(terrain: Terrain, targets: Sequence[Target]) -> int:
    """Returns the number of targets whose success region by the surface measure is reachable."""
    goals = [Goal.of(target, TaskConfig(success=SuccessMeasure.SURFACE)) for target in targets]
    found = [
        _are_reachable(terrain, Goals.of([targets[row] for row in batch], [goals[row] for row in batch]))
        for batch in batches(goals)
    ]
    return int(sum(reached.sum() for reached in found))


def _chosen(tiers: dict[Tier, Bools], place: int) -> tuple[Tier, ...]:
    return tuple(tier for tier, holds in tiers.items() if holds[place])


def _are_reachable(terrain: Terrain, goals: Goals) -> Bools:
    """Returns for each target whether its success region has a free pose on the connected floor from which the target
    is visible."""
    yaw = 2 * np.pi * np.arange(_HEADINGS) / _HEADINGS
    reachable = np.zeros(len(goals.centres), bool)
    for share in _ARRIVAL_SHARES:  # most targets are reachable at the first distance
        rows = np.flatnonzero(~reachable)
        owner, points = _ring(terrain, goals, rows, share * ARRIVAL_RADIUS_M)
        headings = _toward(goals.centres[owner], points)[:, None] + yaw
        fits = terrain.fits(points[:, None, 0], points[:, None, 1], headings, 0.0).any(axis=1)
        reachable[owner[fits]] = True
    return reachable


def _ring_tiers(terrain: Terrain, goals: Goals) -> tuple[dict[Tier, Bools], dict[Tier, Bools]]:
    """Returns by tier (near, mid) whether each target is reachable by straight driving, and by any path.

    Start poses face the target, fit with the spawn margin, are on the connected floor and see the target.
    """
    straight, connected = {}, {}
    for tier, (low, high) in TIER_RANGE_M.items():
        seen, driven = np.zeros((2, len(goals.centres)), np.int64)
        for distance in np.linspace(low, high, _RINGS):  # most targets have enough starts on the first ring
            rows = np.flatnonzero(driven < MIN_STARTS)
            owner, points = _ring(terrain, goals, rows, float(distance), starts=True)
            are_free = _can_drive(terrain, points, goals.chosen(owner))
            seen += np.bincount(owner, minlength=len(seen))
            driven += np.bincount(owner[are_free], minlength=len(seen))
        connected[tier], straight[tier] = seen >= MIN_STARTS, driven >= MIN_STARTS
    return straight, connected


def _ring(
    terrain: Terrain, goals: Goals, rows: Rows, distance_m: float, *, starts: bool = False
) -> tuple[Rows, Floats]:
    """Returns points (N, 2) around some goals from which the target is visible, and the number of the goal of each
    point.

    Args:
        terrain: floor of the scene.
        goals: goals of targets.
        rows: numbers of the goals.
        distance_m: distance from the targets, metres.
        starts: whether to return only points at which a robot that faces the target can start.
    """
    angle = 2 * np.pi * np.arange(_BEARINGS) / _BEARINGS
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = goals.chosen(rows).ring(circle, distance_m).reshape(-1, 2)
    owner = np.repeat(rows, _BEARINGS)
    if starts:
        fit = terrain.can_start(points, _toward(goals.centres[owner], points))
        owner, points = owner[fit], points[fit]
    seen = terrain.grid.see_boxes(points, goals.centres[owner], goals.reaches[owner])
    return owner[seen], points[seen]


def _can_drive(terrain: Terrain, starts: Floats, goals: Goals) -> Bools:
    """Returns whether the straight line from each start (N, 2) to the success region of its target is free."""
    ends = goals.approach(starts, ARRIVAL_RADIUS_M)
    return terrain.grid.are_lines_free(starts, ends, terrain.config.approach_clearance_m)


def sees_matrix(terrain: Terrain, spawns: Floats, targets: tuple[Target, ...], task: TaskConfig) -> NDArray[np.uint8]:
    """Returns (S, T): 1 where a spawn has a free straight path to the success region of a target and sees it."""
    goals = [Goal.of(target, task) for target in targets]
    sees = np.zeros((len(spawns), len(targets)), np.uint8)
    for batch in batches(goals):
        some = Goals.of([targets[row] for row in batch], [goals[row] for row in batch])
        sees[:, batch] = _see(terrain, spawns, some, np.ones((len(batch), len(spawns)), bool)).T
    return sees


def _see(terrain: Terrain, spawns: Floats, goals: Goals, wanted: Bools) -> Bools:
    """Returns (T, S) whether a spawn has a free straight path to a target and sees it; tests `wanted` pairs only."""
    distance = goals.distances(spawns)
    rows, columns = np.nonzero(wanted & (distance >= SEE_RANGE_M[0]) & (distance <= SEE_RANGE_M[1]))
    seen = terrain.grid.see_boxes(spawns[columns], goals.centres[rows], goals.reaches[rows])
    rows, columns = rows[seen], columns[seen]
    sees = np.zeros(wanted.shape, bool)
    sees[rows, columns] = _can_drive(terrain, spawns[columns], goals.chosen(rows))
    return sees


def _toward(centres: Floats, points: Floats) -> Floats:
    """Returns the headings (N,) from points (N, 2) to centroids (N, 2), radians."""
    return np.asarray(np.arctan2(centres[:, 1] - points[:, 1], centres[:, 0] - points[:, 0]))
