"""Recipes of rug textures: a table of colours and patterns. Each shows a whole rug with its border, 512 px square.

Does not read or write files.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.random import Generator

from factory.scenes.author.textures.noise import TEXTURE_SIZE, Pixels, clouds, grid
from schemas.support.numpy_types import Floats

_EDGE_PX, _LINE_PX = 216, (228, 236)
Mask = npt.NDArray[np.bool_]


class _Rug(NamedTuple):
    """Colours of the field, the border and the pattern, sRGB, and the pattern."""

    field: str
    border: str
    accent: str
    pattern: Callable[[Floats, Floats], Mask]


def _medallion(x: Floats, y: Floats) -> Mask:
    ring = np.hypot(x, y)
    return np.asarray((ring < 70) | ((ring > 110) & (ring < 126)) | ((x % 64 < 14) & (y % 64 < 14) & (ring > 150)))


def _stripes(_x: Floats, y: Floats) -> Mask:
    return np.asarray(((255.5 - y) // 36 % 3 == 0) | ((255.5 - y) // 12 % 9 == 5))


def _lozenges(x: Floats, y: Floats) -> Mask:
    return (x + y) % 96 < 18


def _chevrons(x: Floats, y: Floats) -> Mask:
    return (y + np.abs(x % 96 - 48)) % 64 < 22


def _plaid(x: Floats, y: Floats) -> Mask:
    return (x % 80 < 16) ^ (y % 80 < 16) ^ ((x % 80 > 38) & (x % 80 < 44)) ^ ((y % 80 > 38) & (y % 80 < 44))


def _frames(x: Floats, y: Floats) -> Mask:
    return (np.maximum(x, y) % 52 < 14) | (np.maximum(x, y) < 30)


def _dots(x: Floats, y: Floats) -> Mask:
    return np.hypot(x % 72 - 36, y % 72 - 36) < 20


def _stars(x: Floats, y: Floats) -> Mask:
    u, v = np.abs(x % 108 - 54), np.abs(y % 108 - 54)
    return np.asarray((np.maximum(u, v) < 26) | (u + v < 38))


_RUGS = {
    "RugRed": _Rug("#8c2f2c", "#5a1f24", "#d8b98a", _medallion),
    "RugBlue": _Rug("#3a5a86", "#24395a", "#d9d4c4", _stripes),
    "RugCream": _Rug("#d8cdb6", "#b09a78", "#7d6a50", _lozenges),
    "RugGreen": _Rug("#5d7355", "#39492f", "#d2c58f", _medallion),
    "RugGrey": _Rug("#8e9092", "#5c5f63", "#d6d6d2", _stripes),
    "RugOchre": _Rug("#c4913c", "#7a4f22", "#f0dfb4", _stars),
    "RugTeal": _Rug("#3f7f82", "#234b50", "#cfe0d8", _chevrons),
    "RugPlum": _Rug("#6d4660", "#3f2a3c", "#d9b7bf", _frames),
    "RugPlaid": _Rug("#a8433a", "#4b2a2a", "#2f3e4c", _plaid),
    "RugDots": _Rug("#e3dccb", "#6f93a6", "#d9795c", _dots),
    "RugSand": _Rug("#c9b48e", "#8f7a58", "#efe6d0", _frames),
    "RugInk": _Rug("#2f3846", "#1d232d", "#c9c3b2", _chevrons),
}


def _recipe(rug: _Rug) -> Callable[[Generator], Pixels]:
    def draw(rng: Generator) -> Pixels:
        rows, columns = grid()
        x, y = np.abs(columns - 255.5), np.abs(rows - 255.5)
        pixels = np.broadcast_to(_rgb(rug.field), (TEXTURE_SIZE, TEXTURE_SIZE, 3)).copy()
        pixels[rug.pattern(x, y)] = _rgb(rug.accent)
        edge = np.maximum(x, y)
        pixels[edge > _EDGE_PX] = _rgb(rug.border)
        pixels[(edge > _LINE_PX[0]) & (edge < _LINE_PX[1])] = _rgb(rug.accent)
        tone = 0.95 + 0.05 * clouds(rng, 0.3)
        return np.clip(pixels * tone[..., None], 0, 255).astype(np.uint8)

    return draw


def _rgb(colour: str) -> Floats:
    return np.array([int(colour[start : start + 2], 16) for start in (1, 3, 5)], np.float64)


RUGS: Mapping[str, Callable[[Generator], Pixels]] = MappingProxyType(
    {name: _recipe(rug) for name, rug in _RUGS.items()}
)
"""Name -> recipe of a rug."""
