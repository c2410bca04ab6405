"""Image measurements of an expert: position and depth of the target in the frame, and detection of a near obstacle.

Pure functions of the id and depth images. They use no other state of the simulation.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.config import TaskConfig
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from workers.render import Window

_BYTE_SUM_ROWS = 255
"""Largest number of rows whose true pixels can be summed in one byte."""


class MaskMeasures(NamedTuple):
    """Measurements of the target in the image."""

    pixels: int
    """Size of the mask, pixels."""
    column: float
    """Mean column of the mask, pixels from the left edge; the image centre if too few pixels are visible."""
    measure_depth: Callable[[], float]
    """Function that returns the median depth over the mask in metres, 0 if the target is not visible. It is lazy,
    because the median takes longer than all other measurements and most experts do not use it."""


def measure_mask(
    ids: NDArray[np.uint16], depth: NDArray[np.float32], instance_id: int, min_pixels: int, left: int = 0
) -> MaskMeasures:
    """Measures the target's mask (paper Eq. 2-3).

    Args:
        ids: (H, W) instance ids of an image, or of a window that contains the whole mask.
        depth: (H, W) metres along the optical axis.
        instance_id: id of the target.
        min_pixels: smallest mask for which column and depth are measured, pixels.
        left: column of the image at which the window begins.
    """
    mask = ids == instance_id
    pixels = int(np.count_nonzero(mask))
    if pixels < min_pixels:
        return MaskMeasures(pixels, FRAME_SIZE_PX / 2, lambda: 0.0)
    columns = _pixels_by_column(mask)
    # float64 represents this sum of multiples of 0.5 exactly, so a window gives the same column as the whole image
    column = float(np.dot(columns, np.arange(left, left + ids.shape[1]) + 0.5)) / pixels
    return MaskMeasures(pixels, column, lambda: float(np.median(depth[mask])))


def _pixels_by_column(mask: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Returns the number (W,) of true pixels in each column. Sums in uint8 are ten times as fast as wider sums."""
    ones = mask.view(np.uint8)
    counts = np.zeros(mask.shape[1], np.int64)
    for top in range(0, len(ones), _BYTE_SUM_ROWS):
        counts += ones[top : top + _BYTE_SUM_ROWS].sum(axis=0, dtype=np.uint8)
    return counts


def foreground_window(task: TaskConfig) -> Window:
    """Returns the foreground crop of an image."""
    top, bottom = (round(side * FRAME_SIZE_PX) for side in task.crop_rows)
    left, right = (round(side * FRAME_SIZE_PX) for side in task.crop_columns)
    return Window(top, left, bottom, right)


def is_obstacle_near(crop: NDArray[np.float32], task: TaskConfig) -> bool:
    """Returns whether the 5th-percentile depth of the foreground crop is below the limit (paper Sec. III-F).

    The percentile is below the limit if more than 5 % of the valid pixels are below it, so pixels are counted and not
    sorted.

    Args:
        crop: (H, W) depth within `foreground_window`, metres, 0 for invalid pixels.
        task: settings of the task, with the depth limit.
    """
    near = int(np.count_nonzero(crop < task.near_obstacle_depth_m)) - int(np.count_nonzero(crop == 0.0))
    return near > 0 and are_near(near, int(np.count_nonzero(crop)))


def are_near(near: int, valid: int) -> bool:
    """Returns whether an obstacle is near, given the numbers of pixels below the depth limit and of valid pixels."""
    return near > 0.05 * valid
