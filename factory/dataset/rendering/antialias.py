"""Reduces images by whole factors: mean colours, and depth and ids of the middle pixel. Pure functions over arrays."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from workers.render import RenderedFrame

Value = TypeVar("Value", bound=np.generic)


def shrink_frame(frame: RenderedFrame, block: int) -> RenderedFrame:
    """Returns a frame whose width and height are divided by `block`; the frame itself if `block` is 1."""
    if block == 1:
        return frame
    depth, ids = middle_of_blocks(frame.depth, block), middle_of_blocks(frame.ids, block)
    return RenderedFrame(mean_of_blocks(frame.rgb, block), depth.copy(), ids.copy())


def mean_of_blocks(rgb: NDArray[np.uint8], block: int) -> NDArray[np.uint8]:
    """Returns the mean colour of each block of `block` x `block` pixels, (size, size, 3).

    Args:
        rgb: (block * size, block * size, 3) sRGB.
        block: width and height of a block, pixels.
    """
    return np.array(Image.fromarray(rgb).reduce(block))


def middle_of_blocks(image: NDArray[Value], block: int) -> NDArray[Value]:
    """Returns a view of the pixel in the middle of each block of `block` x `block` pixels, (size, size).

    If `block` is even, this is the pixel below and to the right of the middle.

    Args:
        image: (block * size, block * size), for example depth or ids, whose values must not be averaged.
        block: width and height of a block, pixels.
    """
    return image[block // 2 :: block, block // 2 :: block]
