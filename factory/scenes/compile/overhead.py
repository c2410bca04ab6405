"""Adds a ceiling or a floor to a scene without one, and finds whether the sky is visible from the floor.

Pure functions.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from factory.scenes.importer import Part, Surface
from factory.scenes.navigation.floor import SUNK_M, find_floor_height, lowest_level
from schemas.support import portable
from schemas.support.geometry import cross
from schemas.support.numpy_types import Floats, Singles
from workers.geometry.rays import Caster

_CEILING_PATH = "/AddedCeiling"
_FLOOR_PATH = "/AddedFloor"
_PAINT = Surface(colour=(0.72, 0.72, 0.70))
_FLUSH_M = 0.01
_EYE_M = 0.35
_REACH_M = 200.0
_DIRECTIONS = 48
_MOST_BACKS, _STEP_M = 6, np.float32(1e-3)
"""A ray continues `_STEP_M` metres behind each back face that it meets. After `_MOST_BACKS` back faces, it is treated
as if it had hit a front face."""
_SIDES = (0.62, 0.54, 0.57)
"""Direction that divides the triangles into two sets, so the two coincident faces of a double-sided wall are in
different sets. Rays are cast against each set, because a ray may hit either face first."""
_OPEN_SHARE = 0.005
"""A stage counts as open if more than this share of the upward rays leave it."""


def with_ceiling(parts: Sequence[Part], height_m: float | None) -> tuple[Part, ...]:
    """Returns the parts and a flat ceiling over their extent, visible from below; without a height, only the parts.

    Args:
        parts: parts of the stage; the visible ones determine the extent of the ceiling and the height of the floor.
        height_m: height of the ceiling above the floor, metres.

    Raises:
        WorldError: the stage has no floor.
    """
    if height_m is None:
        return tuple(parts)
    shown = np.concatenate([part.triangles for part in parts if not part.is_collider])
    return (*parts, _plane(_CEILING_PATH, shown, find_floor_height(shown) + height_m, is_seen_from_below=True))


def with_floor(parts: Sequence[Part], height_m: float | None, notes: list[str]) -> tuple[Part, ...]:
    """Returns the parts and a flat floor over their extent; without a height, only the parts.

    Args:
        parts: parts of the scene; the visible ones determine the extent of the floor.
        height_m: height of the floor in the scene, metres.
        notes: receives a note if there is a floor at this height; the added one is then slightly below it.
    """
    if height_m is None:
        return tuple(parts)
    shown = np.concatenate([part.triangles for part in parts if not part.is_collider])
    lowest, area = lowest_level(shown, height_m, _FLUSH_M)
    if lowest is not None:
        height_m = min(height_m, lowest - SUNK_M)
        notes.append(
            f"--floor: the file has level faces of {area:.3g} m2 at this height; the added floor is slightly below "
            f"them, at {height_m:.4g} m"
        )
    return (*parts, _plane(_FLOOR_PATH, shown, height_m, is_seen_from_below=False))


def _plane(path: str, shown: Floats, z: float, is_seen_from_below: bool) -> Part:
    """Returns a rectangle over the extent of triangles."""
    (x0, y0), (x1, y1) = shown[..., :2].min(axis=(0, 1)), shown[..., :2].max(axis=(0, 1))
    corners = np.array([(x0, y0, z), (x0, y1, z), (x1, y1, z), (x1, y0, z)])
    order = [[0, 1, 2], [0, 2, 3]] if is_seen_from_below else [[0, 2, 1], [0, 3, 2]]
    return Part(path, corners[order], uvs=None, tints=None, surface=_PAINT)


def is_open(triangles: Floats, spawns: NDArray[np.float32], floor_m: float) -> bool:
    """Returns whether enough upward rays from the spawn points leave the scene, through a missing ceiling or a window.

    Args:
        triangles: (T, 3, 3) visible triangles, world metres.
        spawns: (S, 2) floor points, metres.
        floor_m: height of the floor, metres.
    """
    number = np.arange(_DIRECTIONS) + 0.5
    rise, turn = number / _DIRECTIONS, np.pi * (3 - np.sqrt(5)) * number
    flat = np.sqrt(1 - rise * rise)
    ways = np.column_stack((flat * portable.cos(turn), flat * portable.sin(turn), rise)).astype(np.float32)
    eyes = np.column_stack((spawns, np.full(len(spawns), floor_m + _EYE_M))).astype(np.float32)
    origins, directions = np.repeat(eyes, _DIRECTIONS, axis=0), np.tile(ways, (len(eyes), 1))
    is_upper = cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]) @ _SIDES > 0
    free = np.ones(len(origins), bool)
    for side in (triangles[is_upper], triangles[~is_upper]):
        free[free] = _leave(Caster(side), origins[free], directions[free])
    return int(free.sum()) > _OPEN_SHARE * len(free)


def _leave(caster: Caster, origins: Singles, directions: Singles) -> NDArray[np.bool_]:
    """Returns for each of N rays whether it leaves the scene without hitting a front face.

    A ray that meets `_MOST_BACKS` back faces is treated as if it had hit a front face.
    """
    left, rest = np.zeros(len(origins), bool), np.arange(len(origins))
    for _ in range(_MOST_BACKS):
        distance, is_back = caster.first_hits(origins[rest], directions[rest], _REACH_M)
        left[rest[distance >= _REACH_M]] = True
        origins[rest] += (distance + _STEP_M)[:, None] * directions[rest]
        rest = rest[is_back]
    return left
