"""The measures of one drive: progress, SPL, soft-SPL, the success rule for any instance. Pure; world frame, metres.

SPL: P. Anderson et al., "On Evaluation of Embodied Navigation Agents", arXiv:1807.06757, 2018. Soft-SPL: S. Datta et
al., "Integrating Egocentric Localization for More Realistic Point-Goal Navigation Agents", CoRL 2020.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from schemas.config import TaskConfig
from schemas.scene import Target
from schemas.support.numpy_types import Floats
from workers.geometry.grid import Grid
from workers.planning import geodesic_field, geodesic_m

__all__ = ["floor_distance_m", "has_stopped_at", "path_length_m", "progress", "soft_spl", "spl", "stops_at_any"]

_NEARBY_M = 0.6
"""How far around a pose close to furniture the floor is looked for."""


def progress(start_m: float, now_m: float) -> float:
    """Returns the fraction of the starting distance that is covered (paper Sec. V, OP); negative when driven away.

    Args:
        start_m: distance to the target at the start, or that less the success radius for the normalised measure.
        now_m: the same distance at the end, or the least of the drive.
    """
    return (start_m - now_m) / start_m if start_m > 0 else 0.0


def spl(success: bool, shortest_m: float, driven_m: float) -> float:
    """Returns success weighted by path length, S l / max(p, l) (Anderson et al. 2018, Eq. 1), in [0, 1].

    Args:
        success: S.
        shortest_m: l, the shortest way from the start to success.
        driven_m: p, the way that was driven.
    """
    return _efficiency(shortest_m, driven_m) if success else 0.0


def soft_spl(start_m: float, end_m: float, driven_m: float) -> float:
    """Returns max(0, 1 - d_T / d_0) l / max(p, l) with l = d_0 (Datta et al. 2020): progress in the place of success.

    Args:
        start_m: d_0, the way along the floor to the success circle at the start.
        end_m: d_T, the same at the end.
        driven_m: p.
    """
    covered = max(0.0, 1.0 - end_m / start_m) if start_m > 0 else float(end_m <= 0)
    return covered * _efficiency(start_m, driven_m)


def _efficiency(shortest_m: float, driven_m: float) -> float:
    longest = max(shortest_m, driven_m)
    return shortest_m / longest if longest > 0 else 1.0


def path_length_m(track: Floats) -> float:
    """Returns TL of a (frames, >= 2) track: the sum of planar distances between its points."""
    return float(np.linalg.norm(np.diff(track[:, :2], axis=0), axis=1).sum())


def has_stopped_at(track: Floats, centre_xy: ArrayLike, task: TaskConfig) -> bool:
    """Whether a drive fulfils the success rule at a place: inside the radius and stationary for the hold steps.

    Args:
        track: (frames, >= 2) positions of base_link.
        centre_xy: of the place.
        task: radius, speed limit and hold steps.
    """
    inside = np.linalg.norm(track[1:, :2] - np.asarray(centre_xy), axis=1) <= task.success_radius_m
    speed = np.linalg.norm(np.diff(track[:, :2], axis=0), axis=1) * task.control_hz
    held = inside & (speed < task.stationary_speed_mps)
    if len(held) < task.hold_steps:
        return False
    return bool(np.convolve(held, np.ones(task.hold_steps), "valid").max() >= task.hold_steps - 0.5)


def stops_at_any(track: Floats, targets: Iterable[Target], category: str, task: TaskConfig) -> bool:
    """Whether a drive fulfils the success rule at any target of a category."""
    return any(has_stopped_at(track, target.centroid_m[:2], task) for target in targets if target.category == category)


def floor_distance_m(grid: Grid, xy: ArrayLike, target: Target, radius_m: float) -> float | None:
    """Returns the way along the floor from a point to the success circle, metres; `None` where there is none.

    A robot beside furniture may stand where the floor is too narrow for the field; then its way begins at the nearest
    cell that has one.
    """
    direct = geodesic_m(grid, xy, target, radius_m)
    if direct is not None:
        return direct
    field = geodesic_field(grid, target, radius_m).metres
    cells = np.argwhere(np.isfinite(field))
    if len(cells) == 0:
        return None
    gaps = np.linalg.norm(grid.centre_of(cells) - np.asarray(xy, float), axis=1)
    nearest = int(np.argmin(gaps))
    if gaps[nearest] > _NEARBY_M:
        return None
    row, column = cells[nearest]
    return math.fsum((float(gaps[nearest]), float(field[row, column])))
