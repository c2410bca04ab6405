"""Computes contact shadows of objects on the floor. Pure functions. Does not use lamps.

The few rays from coarse texels of the light map would miss the contact shadows of thin legs.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from schemas.support.numpy_types import Bools, Floats

_SECTION_M = 0.02
_STEP_M = 0.015
_NEAR_M = 0.03
"""Maximum vertical distance of a floor surface from the height of the floor, metres."""
_UP = 0.95
_FADE_M, _DEPTH = 0.065, 0.78
_REACH_M = 0.3
_MOST_SAMPLES = 4_000_000


def contact_shade(triangles: Floats, floor_m: float, points: Floats, normals: Floats) -> Floats:
    """Returns (N,) the light factor, 0..1, near objects on the floor; 1 for points that are not on the floor.

    Args:
        triangles: (T, 3, 3) triangles of the scene, world metres.
        floor_m: height of the floor, metres.
        points: (N, 3) surface points, world metres.
        normals: (N, 3) unit normals of the surfaces.
    """
    shade = np.ones(len(points))
    feet = _section(triangles, floor_m + _SECTION_M)
    rows = np.flatnonzero((np.abs(points[:, 2] - floor_m) < _NEAR_M) & (normals[:, 2] > _UP))
    rows = rows[_are_near(points[rows, :2], feet)] if len(feet) else rows
    if len(feet) and len(rows):
        gap, _ = cKDTree(feet).query(points[rows, :2], distance_upper_bound=_REACH_M)
        shade[rows] = 1 - _DEPTH * np.exp(-np.where(np.isfinite(gap), gap, 1e3) / _FADE_M)
    return shade


def _are_near(points: Floats, feet: Floats) -> Bools:
    """Returns whether each of the points (N, 2) may be within `_REACH_M` of one of the feet (K, 2).

    Tests whether a foot is in the same or an adjacent square of a grid with a pitch of `_REACH_M`.
    """
    low = np.minimum(points.min(axis=0, initial=np.inf), feet.min(axis=0)) - _REACH_M
    of_points, of_feet = (np.floor((places - low) / _REACH_M).astype(np.int64) for places in (points, feet))
    size = np.maximum(of_points.max(axis=0, initial=0), of_feet.max(axis=0)) + 2
    has_feet = np.zeros(size, bool)
    for right in (-1, 0, 1):
        for up in (-1, 0, 1):
            has_feet[of_feet[:, 0] + right, of_feet[:, 1] + up] = True
    return np.asarray(has_feet[of_points[:, 0], of_points[:, 1]])


def _section(triangles: Floats, height_m: float) -> Floats:
    """Returns points (K, 2) along the intersection of the triangles with a horizontal plane."""
    above = triangles[:, :, 2] > height_m
    cut = triangles[above.any(axis=1) & ~above.all(axis=1)]
    is_up = cut[:, :, 2] > height_m
    alone = np.where(is_up.sum(axis=1) == 1, is_up.argmax(axis=1), (~is_up).argmax(axis=1))
    rows = np.arange(len(cut))
    ends = []
    for shift in (1, 2):
        tip, other = cut[rows, alone], cut[rows, (alone + shift) % 3]
        share = (height_m - tip[:, 2]) / (other[:, 2] - tip[:, 2])
        ends.append(tip[:, :2] + share[:, None] * (other - tip)[:, :2])
    start, end = ends
    length = np.linalg.norm(end - start, axis=1)
    step = max(_STEP_M, float(length.sum()) / _MOST_SAMPLES)
    counts = np.ceil(length / step).astype(np.int64) + 1
    owner = np.repeat(rows, counts)
    within = (np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)) / np.maximum(counts[owner] - 1, 1)
    return np.asarray(start[owner] + within[:, None] * (end - start)[owner])
