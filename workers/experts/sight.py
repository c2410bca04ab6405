"""Image measurements of an expert: position and depth of the target in the frame, and detection of a near obstacle.

Pure functions of the id and depth images. They use no ground truth of the simulation.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.config import TaskConfig

__all__ = ["Sighting", "is_obstacle_near", "see"]

_BYTE_SUM_ROWS = 255
"""Largest number of rows whose true pixels can be summed in one byte."""


class Sighting(NamedTuple):
    """Measurements of the target in the image."""

    pixels: int
    """Size of the mask, pixels."""
    column: float
    """Mean column of the mask, pixels from the left edge; the image centre if the target is not visible."""
    measure_depth: Callable[[], float]
    """Function that returns the median depth over the mask in metres, 0 if the target is not visible. It is lazy,
    because the median takes longer than all other measurements and most experts do not use it."""


def see(ids: NDArray[np.uint16], depth: NDArray[np.float32], instance_id: int, min_pixels: int) -> Sighting:
    """Measures the target's mask (paper Eq. 2-3).

    Args:
        ids: (H, W) instance ids.
        depth: (H, W) metres along the optical axis.
        instance_id: id of the target.
        min_pixels: smallest mask for which column and depth are measured, pixels.
    """
    width = ids.shape[1]
    mask = ids == instance_id
    pixels = int(np.count_nonzero(mask))
    if pixels < min_pixels:
        return Sighting(pixels, width / 2, lambda: 0.0)
    columns = _pixels_by_column(mask)
    column = float(np.dot(columns, np.arange(width) + 0.5)) / pixels
    return Sighting(pixels, column, lambda: float(np.median(depth[mask])))


def _pixels_by_column(mask: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Returns (W,) number of true pixels in each column; sums of bytes are ten times as fast as sums of integers."""
    ones = mask.view(np.uint8)
    counts = np.zeros(mask.shape[1], np.int64)
    for top in range(0, len(ones), _BYTE_SUM_ROWS):
        counts += ones[top : top + _BYTE_SUM_ROWS].sum(axis=0, dtype=np.uint8)
    return counts


def is_obstacle_near(depth: NDArray[np.float32], task: TaskConfig) -> bool:
    """Returns whether the 5th-percentile depth of the foreground crop is below the limit (paper Sec. III-F).

    The percentile is below the limit if more than 5 % of the valid pixels are, so counting replaces sorting.

    Args:
        depth: (H, W) metres, 0 for invalid pixels.
        task: gives the crop and the limit.
    """
    height, width = depth.shape
    top, bottom = (round(side * height) for side in task.crop_rows)
    left, right = (round(side * width) for side in task.crop_columns)
    crop = depth[top:bottom, left:right]
    near = int(np.count_nonzero(crop < task.near_obstacle_depth_m)) - int(np.count_nonzero(crop == 0.0))
    if near <= 0:
        return False
    return near > 0.05 * int(np.count_nonzero(crop))
