"""Seamless near-white patterns of 512 x 512 pixels, which are multiplied by the colour of a surface.

The patterns are part of the bytes of a dataset. So their noise is an integer hash, and they use no random generator and
no transform of a library.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from schemas.scene import TEXTURE_SIZE_PX
from schemas.support.numpy_types import Floats, Ints

_N = TEXTURE_SIZE_PX


@functools.lru_cache(maxsize=8)
def draw_pattern(name: str) -> NDArray[np.uint8]:
    """Returns a pattern, (512, 512, 3) sRGB, top row first.

    Raises:
        KeyError: unknown pattern.
    """
    rows, columns = np.meshgrid(np.arange(_N), np.arange(_N), indexing="ij")
    tone = np.clip(PATTERNS[name](rows, columns), 0.0, 1.0)
    return np.repeat(np.rint(tone * 255).astype(np.uint8)[..., None], 3, axis=2)


def _hash(a: Ints, b: Ints, seed: int) -> Floats:
    """Returns numbers 0..1 for pairs of whole numbers (an integer hash like Wang's)."""
    x = (a.astype(np.uint64) * np.uint64(0x9E3779B1) + b.astype(np.uint64) * np.uint64(0x85EBCA77)) + np.uint64(seed)
    for factor, shift in ((0x7FEB352D, 15), (0x846CA68B, 16)):
        x = ((x ^ (x >> np.uint64(shift))) * np.uint64(factor)) & np.uint64(0xFFFFFFFF)
    return np.asarray((x ^ (x >> np.uint64(16))) / 4294967296.0)


def _noise(rows: Ints, columns: Ints, cell: tuple[int, int], seed: int) -> Floats:
    """Returns smooth seamless noise -1..1; `cell` is the number of rows and columns of a noise cell, pixels."""
    result = np.zeros(rows.shape)
    (r, fr), (c, fc) = (
        (place // size, (place % size) / size) for place, size in zip((rows, columns), cell, strict=True)
    )
    fr, fc = fr * fr * (3 - 2 * fr), fc * fc * (3 - 2 * fc)
    for down in (0, 1):
        for right in (0, 1):
            weight = (fr if down else 1 - fr) * (fc if right else 1 - fc)
            result += weight * _hash((r + down) % (_N // cell[0]), (c + right) % (_N // cell[1]), seed)
    return result * 2 - 1


def _clouds(rows: Ints, columns: Ints, sizes: tuple[int, ...], seed: int, stretch: int = 1) -> Floats:
    total = sum(_noise(rows, columns, (size, min(_N, size * stretch)), seed + size) for size in sizes)
    return np.asarray(total / len(sizes))


def _plaster(rows: Ints, columns: Ints) -> Floats:
    return 0.975 + 0.02 * _clouds(rows, columns, (2, 4, 8), 1) + 0.012 * _clouds(rows, columns, (64, 128), 2)


def _concrete(rows: Ints, columns: Ints) -> Floats:
    return 0.93 + 0.06 * _clouds(rows, columns, (16, 64, 128), 3) + 0.035 * _clouds(rows, columns, (1, 2, 4), 4)


def _linoleum(rows: Ints, columns: Ints) -> Floats:
    return 0.95 + 0.05 * _clouds(rows, columns, (2, 4), 5) + 0.02 * _clouds(rows, columns, (32,), 6)


def _carpet(rows: Ints, columns: Ints) -> Floats:
    tone = 0.88 + 0.12 * _clouds(rows, columns, (1, 2), 7) + 0.04 * ((rows // 256 + columns // 256) % 2)
    return np.where((rows % 256 < 2) | (columns % 256 < 2), tone - 0.07, tone)


def _tiles(rows: Ints, columns: Ints) -> Floats:
    cell = _hash(rows // 128, columns // 128, 8)
    tone = 0.93 + 0.05 * cell + 0.02 * _clouds(rows, columns, (8, 32), 9)
    return np.where((rows % 128 < 3) | (columns % 128 < 3), tone * 0.78, tone)


def _planks(rows: Ints, columns: Ints) -> Floats:
    board = rows // 64
    shift = (_hash(board, board * 0, 10) * _N).astype(np.int64)
    along = (columns + shift) % _N
    tone = 0.84 + 0.14 * _hash(board, along // 256, 11) + 0.07 * _clouds(rows, along, (4, 8), 12, stretch=16)
    return np.where((rows % 64 < 2) | (along % 256 < 2), tone * 0.66, tone)


def _brick(rows: Ints, columns: Ints) -> Floats:
    course = rows // 32
    along = (columns + course % 2 * 64) % _N
    tone = 0.84 + 0.1 * _hash(course, along // 128, 13) + 0.07 * _clouds(rows, columns, (2, 4, 16), 14)
    is_joint = (rows % 32 < 4) | (along % 128 < 4)
    return np.where(is_joint, 0.6 + 0.04 * _clouds(rows, columns, (2, 4), 15), tone)


PATTERNS: MappingProxyType[str, Callable[[Ints, Ints], Floats]] = MappingProxyType(
    {
        "plaster": _plaster,
        "concrete": _concrete,
        "linoleum": _linoleum,
        "carpet": _carpet,
        "tiles": _tiles,
        "planks": _planks,
        "brick": _brick,
    }
)
"""Patterns by name."""
