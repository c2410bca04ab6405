"""Reads an atlas of faces at the pixels of a camera: colour is interpolated, depth, ids and normals are nearest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workers.geometry.faces import Sampling

_CHUNK = 1 << 15
"""Pixels that are interpolated together: their values fit into the cache of a core."""
_EVEN, _HALF = np.uint32(0x00FF00FF), np.uint32(0x00800080)
_EIGHT = np.uint32(8)


def resample_colour(atlas: NDArray[np.uint8], sampling: Sampling) -> NDArray[np.uint8]:
    """Returns (N, 3) colours, interpolated between four pixels in steps of 1 / 256 of a pixel.

    Args:
        atlas: (rows, columns, 4) colours; the fourth channel is ignored.
        sampling: N places in the atlas.
    """
    packed = np.ascontiguousarray(atlas).view(np.uint32).ravel()
    stride = atlas.shape[1]
    offsets = np.array((0, 1, stride, stride + 1), np.int32)
    count = len(sampling.first)
    out = np.empty(count, np.uint32)
    for start in range(0, count, _CHUNK):
        part = slice(start, start + _CHUNK)
        first = sampling.first[part]
        # every number of `even` and of `odd` contains two channels, 16 bits each
        even, odd = np.full(len(first), _HALF), np.full(len(first), _HALF)
        for offset, weights in zip(offsets, sampling.weights[:, part], strict=True):
            pixels = packed.take(first + offset)
            even += (pixels & _EVEN) * weights
            odd += ((pixels >> _EIGHT) & _EVEN) * weights
        out[part] = ((even >> _EIGHT) & _EVEN) | (odd & ~_EVEN)
    colours = out.view(np.uint8).reshape(count, 4)[:, :3].copy()
    colours[sampling.void] = 0
    return colours


def resample_depth(atlas: NDArray[np.float32], sampling: Sampling, far_m: float) -> NDArray[np.float32]:
    """Returns (N,) depths of the nearest pixels, axial or radial as the camera defines; 0 beyond `far_m`."""
    depth: NDArray[np.float32] = atlas.ravel().take(sampling.nearest) * sampling.reach
    depth[depth > far_m] = 0
    depth[sampling.void] = 0
    return depth


def resample_ids(atlas: NDArray[np.uint16], sampling: Sampling) -> NDArray[np.uint16]:
    """Returns (N,) ids of the nearest pixels."""
    ids: NDArray[np.uint16] = atlas.ravel().take(sampling.nearest)
    ids[sampling.void] = 0
    return ids


def resample_normals(atlas: NDArray[np.float32], sampling: Sampling) -> NDArray[np.float32]:
    """Returns (N, 3) normals of the nearest pixels."""
    normals: NDArray[np.float32] = atlas.reshape(-1, 3).take(sampling.nearest, axis=0)
    normals[sampling.void] = 0
    return normals
