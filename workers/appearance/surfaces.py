"""Slots of a scene: groups of surfaces of the same kind, texture and colour, whose materials change together.

Pure functions.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.appearance import SurfaceChange
from schemas.scene import CompiledScene
from schemas.support.numpy_types import Bools, Ints

_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")
_KINDS = {"wall": "wall", "walls": "wall", "floor": "floor", "ground": "floor", "ceiling": "ceiling", "roof": "ceiling"}
_FULL = 255
_OTHER_THINGS = ("lamp", "lamps", "light", "lights", "window", "screen")


class SurfaceSlot(NamedTuple):
    """Surfaces that change together."""

    surface: str
    """Kind of the surface: `wall`, `floor`, `ceiling` or `object`."""
    layer: int
    """Texture layer, or -1."""
    colour: str
    """sRGB colour as `#rrggbb`."""


def surface_of(prim_path: str) -> str:
    """Returns the kind of a surface by the words of its prim's path; the last word that names a kind decides."""
    kind = "object"
    for name in prim_path.split("/"):
        words = [word.lower() for word in _WORD.findall(name)]
        if any(word in _OTHER_THINGS for word in words):
            return "object"
        kind = next((_KINDS[word] for word in reversed(words) if word in _KINDS), kind)
    return kind


def find_slots(scene: CompiledScene) -> tuple[list[SurfaceSlot], Ints]:
    """Returns the slots of a scene in a fixed order, and the slots (V,) of its vertices; -1 for lamps."""
    surfaces = {item.id: "object" if item.category else surface_of(item.prim_path) for item in scene.info.instances}
    kinds = ("object", "wall", "floor", "ceiling")
    of_part = np.array([kinds.index(surfaces.get(int(number), "object")) for number in scene.part_instance], np.int64)
    counts = scene.part_count.astype(np.int64)
    vertex = _vertices(scene)
    rgb = scene.colours.astype(np.int64)[vertex]
    packed = rgb[:, 0] << 16 | rgb[:, 1] << 8 | rgb[:, 2]
    layer = np.repeat(scene.part_texture.astype(np.int64), counts)
    keys = (np.repeat(of_part, counts) << 40) | ((layer + 1) << 24) | packed
    dark = _emits(scene)[vertex]
    keys_of_slots, slot = np.unique(keys[~dark], return_inverse=True)
    of_vertex = np.full(len(scene.positions), -1, np.int64)
    of_vertex[vertex[~dark]] = slot
    slots = [
        SurfaceSlot(kinds[key >> 40], ((key >> 24) & 0xFFFF) - 1, f"#{key & 0xFFFFFF:06x}")
        for key in keys_of_slots.tolist()
    ]
    return slots, of_vertex


def as_slot(change: SurfaceChange) -> SurfaceSlot:
    return SurfaceSlot(change.surface, change.layer, change.colour)


def rgb_of(colour: str) -> tuple[int, int, int]:
    """Returns the channels 0..255 of `#rrggbb`."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def hex_of(rgb: NDArray[np.generic] | tuple[float, float, float]) -> str:
    """Returns `#rrggbb` of channels 0..255, rounded and clipped."""
    red, green, blue = (min(max(round(float(value)), 0), _FULL) for value in rgb)
    return f"#{red:02x}{green:02x}{blue:02x}"


def _vertices(scene: CompiledScene) -> Ints:
    """Returns the indices of the vertices of all parts, in the order of the parts."""
    counts = scene.part_count.astype(np.int64)
    firsts = np.repeat(scene.part_first - (np.cumsum(counts) - counts), counts)
    return np.asarray(firsts + np.arange(counts.sum()))


def _emits(scene: CompiledScene) -> Bools:
    """Returns whether each of the V vertices belongs to a triangle with full light at all corners, as lamps have."""
    if not scene.light_map.size:
        return np.zeros(len(scene.positions), bool)
    rows, columns = scene.light_map.shape[:2]
    texels = (scene.light_uvs * (columns, rows)).astype(np.int64).clip(0, (columns - 1, rows - 1))
    full = (scene.light_map[texels[:, 1], texels[:, 0]] == _FULL).all(axis=1)
    return np.repeat(full.reshape(-1, 3).all(axis=1), 3)
