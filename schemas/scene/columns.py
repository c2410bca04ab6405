"""Transforms vertex positions and light maps losslessly into arrays that compress better, for packages of format 4.

Pure functions. Does not compress.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from schemas.encoding.arrays import ArraySpec
from schemas.errors import InvalidBundle

PLACES = ArraySpec("places", (None, 3), np.float32, "m", -1e4, 1e4)
"""(U, 3) distinct vertex positions in the order of their first use, metres."""
PLACE_STEPS = ArraySpec("place_steps", (None,), np.uint32, "1")
"""(V,) for each vertex, the number of distinct places before it minus the index of its place; 0 for a new place."""
LIGHT_STEPS = ArraySpec("light_steps", (3, None, None), np.uint8, "1")
"""(3, H, W) green, red - green and blue - green of the light map; each as the difference to the texel on the left."""


def split_positions(positions: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Returns `PLACES` and `PLACE_STEPS` of vertex positions (V, 3)."""
    rows = np.ascontiguousarray(positions).view(np.dtype((np.void, 12))).reshape(-1)
    _, firsts, found = np.unique(rows, return_index=True, return_inverse=True)
    order = np.argsort(firsts)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    place = rank[found]
    used = np.concatenate(([0], np.maximum.accumulate(place)[:-1] + 1)) if len(place) else place
    return positions[firsts[order]], (used - place).astype(np.uint32)


def join_positions(places: NDArray[np.float32], steps: NDArray[np.uint32]) -> NDArray[np.float32]:
    """Returns the vertex positions (V, 3) of `PLACES` and `PLACE_STEPS`.

    Raises:
        InvalidBundle: a step refers to a place that does not exist, or a place is not used.
    """
    is_first = steps == 0
    used = np.cumsum(is_first)
    rows = used - is_first - steps.astype(np.int64)
    if rows.min(initial=0) < 0 or np.count_nonzero(is_first) != len(places):
        raise InvalidBundle("scene refused", ["place_steps does not match the places in the package"])
    return np.asarray(places[rows], np.float32)


def split_light(light_map: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Returns `LIGHT_STEPS` of a light map (H, W, 3); all differences are modulo 256."""
    red, green, blue = (light_map[..., channel] for channel in range(3))
    planes = np.stack((green, red - green, blue - green))
    planes[:, :, 1:] -= planes[:, :, :-1].copy()
    return planes


def join_light(steps: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Returns the light map (H, W, 3) of `LIGHT_STEPS`."""
    green, red, blue = np.cumsum(steps, axis=2, dtype=np.uint8)
    return np.stack((red + green, green, blue + green), axis=2)
