"""Computes which targets the robot can reach, and from which tiers: by straight driving or by any path.

Pure and deterministic: tests lattices of poses on the occupancy grid. Does not simulate and does not sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from schemas.config import SpawnConfig, TaskConfig
from schemas.measure import Goal
from schemas.scene import Target
from schemas.support.numpy_types import Bools, Floats
from schemas.terms import FAR_FLOOR_M, TIER_RANGE_M, Tier
from workers.geometry.grid import Grid, are_within, body_centre

ARRIVAL_RADIUS_M = 0.97
"""Distance from the target at which the robot stops within the success region, by the success measure, metres."""
SEE_RANGE_M = (1.5, 11.0)
"""Minimum and maximum distance of a spawn that counts for a target, metres."""
MIN_STARTS = 3
"""Minimum number of valid lattice poses of a tier, so that random sampling finds one."""
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
        """Returns for base_link poses whether the footprint is free and on the connected floor."""
        on_floor = self.grid.values_at(self.floor, body_centre(x, y, yaw), False)
        return np.asarray(on_floor.astype(bool) & self.grid.are_poses_free(x, y, yaw, margin_m))

    def can_start(self, points: Floats, yaw: ArrayLike) -> Bools:
        """Returns for base_link points (N, 2) whether it fits with the spawn margin and outside all boxes."""
        fits = self.fits(points[:, 0], points[:, 1], yaw, self.config.margin_m)
        return np.asarray(fits & ~are_within(points, self.taken))


def tiers_of(
    terrain: Terrain, target: Target, goal: Goal, spawns: Floats
) -> tuple[tuple[Tier, ...], tuple[Tier, ...]] | None:
    """Returns the tiers from which a target is reachable by straight driving, and by any path; `None` if it is not.

    Args:
        terrain: floor of the scene.
        target: target to reach.
        goal: its success region; its measure applies to the distances of the tiers, too.
        spawns: (S, 2) surveyed points, metres.
    """
    if not _is_reachable(terrain, target, goal):
        return None
    straight, connected = _ring_tiers(terrain, target, goal)
    is_far = goal.distances(spawns) >= FAR_FLOOR_M[0]  # the path along the floor is at least as long
    if (is_far & _sees(terrain, spawns, target, goal)).any():
        straight.append(Tier.FAR)
    if is_far.any():
        connected.append(Tier.FAR)
    return tuple(straight), tuple(connected)


def _is_reachable(terrain: Terrain, target: Target, goal: Goal) -> bool:
    """Returns whether a pose in the success region is free, on the connected floor and in sight of the target."""
    yaw = 2 * np.pi * np.arange(_HEADINGS) / _HEADINGS
    for share in _ARRIVAL_SHARES:  # most targets are reachable at the first distance
        points = _rings(goal, np.array([share * ARRIVAL_RADIUS_M]))
        points = points[terrain.grid.have_sight(points, target)]
        headings = _toward(goal, points)[:, None] + yaw
        if terrain.fits(points[:, None, 0], points[:, None, 1], headings, 0.0).any():
            return True
    return False


def _ring_tiers(terrain: Terrain, target: Target, goal: Goal) -> tuple[list[Tier], list[Tier]]:
    """Returns the tiers (near, mid) from which a target is reachable by straight driving, and by any path.

    Start poses face the target, fit with the spawn margin, are on the connected floor and see the target.
    """
    straight, connected = [], []
    for tier, (low, high) in TIER_RANGE_M.items():
        seen = driven = 0
        for distance in np.linspace(low, high, _RINGS):  # most targets have enough starts on the first ring
            points = _rings(goal, np.array([distance]))
            starts = points[terrain.can_start(points, _toward(goal, points))]
            starts = starts[terrain.grid.have_sight(starts, target)]
            ends = goal.approach(starts, ARRIVAL_RADIUS_M)
            seen += len(starts)
            driven += int(terrain.grid.are_lines_free(starts, ends, terrain.config.approach_clearance_m).sum())
            if driven >= MIN_STARTS:
                break
        connected += [tier] if seen >= MIN_STARTS else []
        straight += [tier] if driven >= MIN_STARTS else []
    return straight, connected


def sees_matrix(terrain: Terrain, spawns: Floats, targets: tuple[Target, ...], task: TaskConfig) -> NDArray[np.uint8]:
    """Returns (S, T): 1 where a spawn has a free straight path to the success region of a target and sees it."""
    columns = [_sees(terrain, spawns, target, Goal.of(target, task)) for target in targets]
    return np.array(columns, np.uint8).reshape(len(targets), len(spawns)).T.copy()


def _sees(terrain: Terrain, spawns: Floats, target: Target, goal: Goal) -> Bools:
    distance = goal.distances(spawns)
    rows = np.flatnonzero((distance >= SEE_RANGE_M[0]) & (distance <= SEE_RANGE_M[1]))
    rows = rows[terrain.grid.have_sight(spawns[rows], target)]
    ends = goal.approach(spawns[rows], ARRIVAL_RADIUS_M)
    sees = np.zeros(len(spawns), bool)
    sees[rows] = terrain.grid.are_lines_free(spawns[rows], ends, terrain.config.approach_clearance_m)
    return sees


def _rings(goal: Goal, distances: Floats) -> Floats:
    """Returns points (R * B, 2) at distances from a goal's target."""
    angle = 2 * np.pi * np.arange(_BEARINGS) / _BEARINGS
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return goal.ring(np.tile(circle, (len(distances), 1)), np.repeat(distances, _BEARINGS))


def _toward(goal: Goal, points: Floats) -> Floats:
    """Returns the headings (N,) from points to the centroid, radians."""
    return np.asarray(np.arctan2(goal.centre_m[1] - points[:, 1], goal.centre_m[0] - points[:, 0]))
