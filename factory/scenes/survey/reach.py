"""Which things the robot can reach, and from which tiers: by straight driving or by any way round.

Pure and deterministic: tries lattices of poses on the grid; never simulates and never draws at random.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from schemas.config import SpawnConfig
from schemas.scene import Target
from schemas.terms import TIER_RANGE_M, Tier
from workers.geometry.grid import Grid, are_within, body_centre, straight_end

__all__ = ["ARRIVAL_RADIUS_M", "SEE_RANGE_M", "Terrain", "is_reachable", "ring_tiers", "sees_matrix"]

ARRIVAL_RADIUS_M = 0.97
"""Where the robot comes to rest within the success circle, metres from the centroid."""
SEE_RANGE_M = (1.5, 11.0)
"""Distances from which a spawn counts for a target, metres."""
MIN_STARTS = 3
"""How many poses of the lattice a tier needs, so that random draws find them too."""
_ARRIVAL_SHARES = (1.0, 0.85, 0.7, 0.5, 0.3)
_BEARINGS, _HEADINGS, _RINGS = 48, 16, 6

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Terrain:
    """The grid with what follows from it."""

    grid: Grid
    floor: Bools
    """(H, W) the connected floor of the body centre."""
    config: SpawnConfig
    taken: Floats
    """(K, 2, 2) lower and upper corners x, y of what things of a category take up, metres."""

    def fits(self, x: ArrayLike, y: ArrayLike, yaw: ArrayLike, margin_m: float) -> Bools:
        """Tells for base_link poses whether the footprint is free and stands on the connected floor."""
        on_floor = self.grid.values_at(self.floor, body_centre(x, y, yaw), False)
        return np.asarray(on_floor.astype(bool) & self.grid.are_poses_free(x, y, yaw, margin_m))

    def can_start(self, points: Floats, yaw: ArrayLike) -> Bools:
        """Tells for base_link at points (N, 2) whether it fits with the spawn margin, and beneath nothing."""
        fits = self.fits(points[:, 0], points[:, 1], yaw, self.config.margin_m)
        return np.asarray(fits & ~are_within(points, self.taken))


def _rings(centre: Floats, radii: ArrayLike) -> Floats:
    """Points (R * B, 2) on circles about a centre."""
    angle = 2 * np.pi * np.arange(_BEARINGS) / _BEARINGS
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.asarray((centre + np.asarray(radii, float)[:, None, None] * circle).reshape(-1, 2))


def is_reachable(terrain: Terrain, target: Target) -> bool:
    """Whether some pose inside the success circle is free, on the connected floor and in sight of the target."""
    centre = np.asarray(target.centroid_m[:2])
    points = _rings(centre, np.asarray(_ARRIVAL_SHARES) * ARRIVAL_RADIUS_M)
    points = points[terrain.grid.have_sight(points, target)]
    yaw = 2 * np.pi * np.arange(_HEADINGS) / _HEADINGS
    toward = np.arctan2(centre[1] - points[:, 1], centre[0] - points[:, 0])
    fits = terrain.fits(points[:, None, 0], points[:, None, 1], toward[:, None] + yaw, 0.0)
    return bool(fits.any())


def ring_tiers(terrain: Terrain, target: Target) -> tuple[tuple[Tier, ...], tuple[Tier, ...]]:
    """Returns the tiers among near and mid from which a target can be driven to straight, and at all.

    Starts face the target, fit with the spawn margin, stand on the connected floor and have the target in sight.
    """
    straight, connected = [], []
    centre = np.asarray(target.centroid_m[:2])
    for tier, (low, high) in TIER_RANGE_M.items():
        points = _rings(centre, np.linspace(low, high, _RINGS))
        toward = np.arctan2(centre[1] - points[:, 1], centre[0] - points[:, 0])
        starts = points[terrain.can_start(points, toward)]
        starts = starts[terrain.grid.have_sight(starts, target)]
        if len(starts) >= MIN_STARTS:
            connected.append(tier)
            ends = straight_end(starts, centre, ARRIVAL_RADIUS_M)
            lines = terrain.grid.are_lines_free(starts, ends, terrain.config.approach_clearance_m)
            if int(lines.sum()) >= MIN_STARTS:
                straight.append(tier)
    return tuple(straight), tuple(connected)


def sees_matrix(terrain: Terrain, spawns: Floats, targets: tuple[Target, ...]) -> NDArray[np.uint8]:
    """Returns (S, T) 1 where a spawn has a free straight way to a target's success circle, and sight of it."""
    sees = np.zeros((len(spawns), len(targets)), np.uint8)
    for column, target in enumerate(targets):
        centre = np.asarray(target.centroid_m[:2])
        distance = np.linalg.norm(spawns - centre, axis=1)
        rows = np.flatnonzero((distance >= SEE_RANGE_M[0]) & (distance <= SEE_RANGE_M[1]))
        rows = rows[terrain.grid.have_sight(spawns[rows], target)]
        ends = straight_end(spawns[rows], centre, ARRIVAL_RADIUS_M)
        free = terrain.grid.are_lines_free(spawns[rows], ends, terrain.config.approach_clearance_m)
        sees[rows[free], column] = 1
    return sees
