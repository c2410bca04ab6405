"""Finds the flat tops of objects, and the things above them. Decides nothing about words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from schemas.scene import CompiledScene
from schemas.support.numpy_types import Bools, Floats, Ints

_FLAT_M, _FLAT_SHARE, _UPRIGHT = 0.02, 0.6, 0.98
"""A top is flat if faces within the height `_FLAT_M` (metres) below it, whose unit normals have a z above `_UPRIGHT`,
cover the share `_FLAT_SHARE` of the footprint."""
_ABOVE_M = 0.6
"""Height of the space above a top, metres. A top is empty only if no other instance reaches into this space."""
_EDGE_M = 0.03
"""Width at the edge of a top that is not examined, because walls and other furniture touch it, metres."""

Corner = tuple[float, float, float]


@dataclass(frozen=True)
class SurfaceTop:
    """Flat upper side of an object."""

    height_m: float
    """z in the world frame, metres."""
    above: tuple[tuple[Corner, Corner], ...]
    """Lower and upper corners of the boxes around all other instances with a face in the space above it, metres."""


def find_tops(scene: CompiledScene, objects: Mapping[int, tuple[Sequence[int], Floats]]) -> dict[int, SurfaceTop]:
    """Returns the flat tops of objects; objects without one are omitted.

    Args:
        scene: compiled scene.
        objects: number of each object -> instance ids of its parts, and vertices (K, 2) of its footprint, metres.
    """
    if not objects:
        return {}
    faces = scene.positions.reshape(-1, 3, 3).astype(np.float64)
    order = np.argsort(scene.part_first, kind="stable")
    owner = np.repeat(scene.part_instance[order].astype(np.int64), scene.part_count[order] // 3)
    low, high = faces.min(axis=1), faces.max(axis=1)
    found = {number: _top_of(faces, low, high, owner, *own) for number, own in objects.items()}
    return {number: top for number, top in found.items() if top is not None}


def _top_of(
    faces: Floats, low: Floats, high: Floats, owner: Ints, ids: Sequence[int], outline: Floats
) -> SurfaceTop | None:
    own = np.isin(owner, ids)
    if not own.any():
        return None
    floor, top = low[own].min(axis=0), high[own].max(axis=0)
    ahead = np.roll(outline, -1, axis=0)
    area = float(outline[:, 0] @ ahead[:, 1] - ahead[:, 0] @ outline[:, 1]) / 2
    if not _is_flat(faces[own], float(top[2]), area):
        return None
    inside = (low[:, :2] < top[:2] - _EDGE_M).all(axis=1) & (high[:, :2] > floor[:2] + _EDGE_M).all(axis=1)
    inside &= (low[:, 2] < top[2] + _ABOVE_M) & (high[:, 2] > top[2] + _FLAT_M) & ~own
    boxes = [_box(low, high, owner == number) for number in np.unique(owner[inside]).tolist()]
    return SurfaceTop(float(top[2]), tuple(boxes))


def _is_flat(faces: Floats, top_m: float, area_m2: float) -> bool:
    """Returns whether horizontal faces at the top cover most of the area of the footprint."""
    level = faces[(faces[:, :, 2] > top_m - _FLAT_M).all(axis=1)]
    normal = np.cross(level[:, 1] - level[:, 0], level[:, 2] - level[:, 0])
    length = np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
    upright = normal[:, 2] / length > _UPRIGHT
    return float(normal[upright, 2].sum()) / 2 >= _FLAT_SHARE * area_m2


def _box(low: Floats, high: Floats, chosen: Bools) -> tuple[Corner, Corner]:
    (x0, y0, z0), (x1, y1, z1) = low[chosen].min(axis=0).tolist(), high[chosen].max(axis=0).tolist()
    return (x0, y0, z0), (x1, y1, z1)
