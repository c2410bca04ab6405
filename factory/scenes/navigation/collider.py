"""Builds the collider of a scene: one welded, concave triangle mesh of all solid parts except the floor.

Prefers authored collision geometry. Does not simplify meshes, and moves vertices by the weld distance at most.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from factory.scenes.importer import Part
from schemas.support.numpy_types import Floats

COLLIDER_TOP_M = 2.2
"""Height above the floor up to which geometry is part of the collider, metres."""
FLOOR_SKIN_M = 0.005
"""Height above the floor up to which geometry counts as floor, metres."""
_WELD_M = 1e-4
_PROXY_MARGIN_M = 0.1


def solid_triangles(visible: Sequence[Part], colliders: Sequence[Part], floor_m: float) -> Floats:
    """Returns the solid triangles (T, 3, 3), world metres.

    Authored colliders with the same parent prim replace the visible parts below this prim that are inside the bounding
    box of these colliders. Colliders directly below the root prim replace nothing.

    Args:
        visible: visible parts.
        colliders: parts authored for collision only.
        floor_m: height of the floor, metres.
    """
    boxes = _boxes_by_parent(colliders)
    shown = [part for part in visible if not _is_replaced(part, boxes)]
    triangles = [part.triangles for part in (*shown, *colliders)]
    every = np.concatenate(triangles) if triangles else np.zeros((0, 3, 3))
    top, bottom = every[:, :, 2].max(axis=1), every[:, :, 2].min(axis=1)
    return np.asarray(every[(top > floor_m + FLOOR_SKIN_M) & (bottom < floor_m + COLLIDER_TOP_M)])


def _boxes_by_parent(colliders: Sequence[Part]) -> dict[str, Floats]:
    """Returns the bounding box (2, 3) of the colliders directly below each prim except the root prim."""
    boxes: dict[str, Floats] = {}
    for part in colliders:
        parent = part.path.rpartition("/")[0]
        corners = part.triangles.reshape(-1, 3)
        known = boxes.get(parent)
        if parent.count("/") > 1:
            both = corners if known is None else np.concatenate([known, corners])
            boxes[parent] = np.stack([both.min(axis=0), both.max(axis=0)])
    return boxes


def _is_replaced(part: Part, boxes: dict[str, Floats]) -> bool:
    path = part.path.rpartition("/")[0]
    corners = part.triangles.reshape(-1, 3)
    while path:
        box = boxes.get(path)
        if box is not None:
            lower, upper = box[0] - _PROXY_MARGIN_M, box[1] + _PROXY_MARGIN_M
            return bool((corners >= lower).all() and (corners <= upper).all())
        path = path.rpartition("/")[0]
    return False


def weld(triangles: Floats) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Merges equal corners and drops degenerate and duplicate triangles.

    Returns:
        Vertices (M, 3), metres, and the triangles as indices (K, 3) of vertices.
    """
    keys = np.rint(triangles.reshape(-1, 3) / _WELD_M).astype(np.int64)
    keys -= keys.min(axis=0, initial=0)
    spans = keys.max(axis=0, initial=0) + 1
    codes = np.ravel_multi_index(tuple(keys.T), tuple(spans))
    _, first, owner = np.unique(codes, return_index=True, return_inverse=True)
    vertices = triangles.reshape(-1, 3)[first].astype(np.float32)
    faces = owner.reshape(-1, 3)
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    _, kept = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return vertices, faces[np.sort(kept)].astype(np.int32)
