"""Converts frames to network input: downscaled colour and depth. Pure; cache and policy get identical bytes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image

__all__ = ["FAR_M", "PREPROCESS_VERSION", "SIZES", "shrink_depth", "shrink_mask", "shrink_rgb", "to_input"]

PREPROCESS_VERSION = 1
"""Version of the preprocessing. Increase it with any change here, so that old caches and checkpoints are not reused."""
SIZES = (64, 80, 128, 160)
"""Valid picture sides, pixels; each divides the frame size."""
FAR_M = 10.0
"""Maximum depth, metres. Larger depths, and 0 (the ray hits nothing), are set to this value."""
_MM_PER_M = 1000.0


def shrink_rgb(rgb: NDArray[np.uint8], size: int) -> NDArray[np.uint8]:
    """Returns the mean colour of each pixel block, (size, size, 3).

    Args:
        rgb: (640, 640, 3) sRGB.
        size: One of `SIZES`.
    """
    return np.asarray(Image.fromarray(rgb).reduce(len(rgb) // size), np.uint8)


def shrink_depth(depth: NDArray[np.float32], size: int) -> NDArray[np.uint16]:
    """Returns the depth at the centre of each block, (size, size) millimetres, at most `FAR_M`.

    Args:
        depth: (640, 640) metres along the optical axis.
        size: One of `SIZES`.
    """
    block = len(depth) // size
    middle = depth[block // 2 :: block, block // 2 :: block]
    metres = np.where((middle <= 0) | (middle > FAR_M), FAR_M, middle)
    return np.rint(metres * _MM_PER_M).astype(np.uint16)


def shrink_mask(ids: NDArray[np.uint16], instance_id: int, size: int) -> NDArray[np.uint8]:
    """Returns the share of each block that shows an instance, (size, size), 0..255. Used for training only."""
    block = len(ids) // size
    hits = (ids == instance_id).reshape(size, block, size, block).mean(axis=(1, 3))
    shares: NDArray[np.uint8] = np.rint(hits * 255).astype(np.uint8)
    return shares


def to_input(rgb: NDArray[np.uint8], depth: NDArray[np.uint16]) -> NDArray[np.float32]:
    """Returns the network input (N, 4, S, S): colour and nearness channels, each about -1..1.

    Args:
        rgb: (N, S, S, 3) downscaled colour.
        depth: (N, S, S) downscaled depth, millimetres. The logarithm gives more resolution to the last metre, where the
            stop happens.
    """
    colours = rgb.transpose(0, 3, 1, 2).astype(np.float32) / 127.5 - 1.0
    metres = np.clip(depth.astype(np.float32) / _MM_PER_M, 0.1, FAR_M)
    nearness = 1.0 - np.log(metres / 0.1) / np.float32(np.log(FAR_M / 0.1) / 2)
    return np.ascontiguousarray(np.concatenate([colours, nearness[:, None]], axis=1), np.float32)
