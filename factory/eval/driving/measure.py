"""Metrics of one rollout: progress, SPL, soft-SPL, the success rule for any instance, and odometry.

Pure functions; positions in the world frame, metres. Simulates nothing.

SPL: P. Anderson et al., "On Evaluation of Embodied Navigation Agents", arXiv:1807.06757, 2018. Soft-SPL: S. Datta et
al., "Integrating Egocentric Localization for More Realistic Point-Goal Navigation Agents", CoRL 2020.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from schemas.config import TaskConfig
from schemas.measure import Goal
from schemas.scene import Target
from schemas.support.numpy_types import Floats
from workers.geometry.grid import Grid
from workers.planning import geodesic_field, geodesic_m

_NEARBY_M = 0.6
"""Largest distance from a position outside of the distance field to the nearest cell of the field, metres. Beyond it,
`floor_distance_m` finds no path."""


def progress(start_m: float, now_m: float) -> float:
    """Returns the covered fraction of the initial distance (paper Sec. V, OP); negative if the distance increased.

    Args:
        start_m: Distance to the target at the start.
        now_m: Distance to the target at the end, or its minimum over the rollout. For the normalised metric, the
            success radius is subtracted from both distances.
    """
    return (start_m - now_m) / start_m if start_m > 0 else 0.0


def spl(success: bool, shortest_m: float, driven_m: float) -> float:
    """Returns success weighted by path length, S l / max(p, l) (Anderson et al. 2018, Eq. 1), in [0, 1].

    Args:
        success: S.
        shortest_m: l, length of the shortest path from the start to the success region.
        driven_m: p, length of the driven path.
    """
    return _efficiency(shortest_m, driven_m) if success else 0.0


def soft_spl(start_m: float, end_m: float, driven_m: float) -> float:
    """Returns max(0, 1 - d_T / d_0) l / max(p, l) with l = d_0 (Datta et al. 2020).

    This is SPL with the progress in place of the success.

    Args:
        start_m: d_0, geodesic distance to the success region at the start.
        end_m: d_T, geodesic distance to the success region at the end.
        driven_m: p, length of the driven path.
    """
    covered = max(0.0, 1.0 - end_m / start_m) if start_m > 0 else float(end_m <= 0)
    return covered * _efficiency(start_m, driven_m)


def _efficiency(shortest_m: float, driven_m: float) -> float:
    longest = max(shortest_m, driven_m)
    return shortest_m / longest if longest > 0 else 1.0


def path_length_m(track: Floats) -> float:
    """Returns TL of a (frames, >= 2) track: the sum of planar distances between its points."""
    return float(np.linalg.norm(np.diff(track[:, :2], axis=0), axis=1).sum())


def has_stopped_at(track: Floats, goal: Goal, task: TaskConfig) -> bool:
    """Returns whether a track meets the success rule at a goal: inside it and stationary for the hold steps.

    Args:
        track: (frames, >= 2) positions of base_link.
        goal: Success region.
        task: Speed limit and hold steps.
    """
    inside = goal.distances(track[1:, :2]) <= goal.radius_m
    speed = np.linalg.norm(np.diff(track[:, :2], axis=0), axis=1) * task.control_hz
    held = inside & (speed < task.stationary_speed_mps)
    if len(held) < task.hold_steps:
        return False
    return bool(np.convolve(held, np.ones(task.hold_steps), "valid").max() >= task.hold_steps - 0.5)


def stops_at_any(track: Floats, targets: Iterable[Target], category: str, task: TaskConfig) -> bool:
    """Returns whether a track meets the success rule at any target of a category."""
    return any(has_stopped_at(track, Goal.of(target, task), task) for target in targets if target.category == category)


def floor_distance_m(grid: Grid, xy: ArrayLike, target: Target, task: TaskConfig) -> float | None:
    """Returns the geodesic distance from a point to the success region, metres; `None` without a path.

    A robot next to furniture can be outside of the distance field, because the floor there is too narrow. In this
    case, the result is the distance to the nearest cell of the field plus the distance of that cell.
    """
    direct = geodesic_m(grid, xy, target, task)
    if direct is not None:
        return direct
    field = geodesic_field(grid, target, task).metres
    cells = np.argwhere(np.isfinite(field))
    if len(cells) == 0:
        return None
    gaps = np.linalg.norm(grid.centre_of(cells) - np.asarray(xy, float), axis=1)
    nearest = int(np.argmin(gaps))
    if gaps[nearest] > _NEARBY_M:
        return None
    row, column = cells[nearest]
    return math.fsum((float(gaps[nearest]), float(field[row, column])))


def yaws_of(track: Floats) -> Floats:
    """Returns the headings, (frames,) radians, of a (frames, 7) track x, y, z, qw, qx, qy, qz."""
    w, x, y, z = track[:, 3:].T
    return np.asarray(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


def odometry(track: Floats) -> Floats:
    """Returns the last pose of a (frames, 7) track in the frame of its first pose: x, y in metres, yaw in radians."""
    yaws = yaws_of(track[[0, -1]])
    dx, dy = track[-1, :2] - track[0, :2]
    cos, sin = math.cos(yaws[0]), math.sin(yaws[0])
    turn = math.remainder(float(yaws[1] - yaws[0]), 2 * math.pi)
    return np.array((cos * dx + sin * dy, cos * dy - sin * dx, turn))
