"""Observation before each action: pose of the robot, and a camera image that is rendered on the first access.

Experts and policies get their input from this module, with the measures of the target's mask (position, depth) and of
near obstacles. It does not decide when an episode ends.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.config import TaskConfig
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.frame import Frame
from schemas.job import Job
from schemas.terms import EndReason
from workers.geometry.pose import Pose
from workers.render import DepthAndIds, PartialRenderer, Renderer, Window, as_partial

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


class Observation:
    """State before the next action; after the end, the state before the last action; implements `ExpertObservation`.

    The camera image is rendered on the first access, because many controllers do not use it.

    Args:
        renderer: returns the renderer with the scene loaded; raises if the episode is over.
        job: job, with the thresholds for a visible target and a near obstacle.
        instance_id: id of the target.
        pose: pose of base_link in the world frame.
        distance_m: planar distance from base_link to the target by the success measure, metres.
        bearing_rad: angle from the robot's heading to the target's centroid, counter-clockwise, in [-pi, pi], radians.
        is_touching: whether the robot touches anything other than the floor.
    """

    end: EndReason | None = None
    """Reason for the end of the episode, or `None` before it."""

    def __init__(
        self,
        *,
        renderer: Callable[[], Renderer],
        job: Job,
        instance_id: int,
        pose: Pose,
        distance_m: float,
        bearing_rad: float,
        is_touching: bool,
    ) -> None:
        self._renderer, self._job, self._instance_id = renderer, job, instance_id
        self.pose, self.distance_m, self.bearing_rad, self.is_touching = pose, distance_m, bearing_rad, is_touching

    @cached_property
    def frame(self) -> Frame:
        return self._renderer().render(self.pose)

    @cached_property
    def depth_and_ids(self) -> DepthAndIds:
        """Depth and ids, from the frame if it has been rendered, else rendered without colour."""
        if "frame" in self.__dict__:
            return DepthAndIds(self.frame.depth, self.frame.ids)
        return self._renderer().render_depth_and_ids(self.pose)

    @cached_property
    def target_mask(self) -> MaskMeasures:
        renderer, left = self._partial, 0
        if renderer is None:
            image = self.depth_and_ids
        else:
            (_, left, _, _), image = renderer.render_instance(self.pose, self._instance_id)
        return measure_mask(
            image.ids, image.depth, instance_id=self._instance_id, min_pixels=self._job.gains.min_mask_px, left=left
        )

    @cached_property
    def obstacle_near(self) -> bool:
        """Whether an obstacle is close in front of the camera."""
        task = self._job.task
        window, renderer = foreground_window(task), self._partial
        if renderer is not None:
            near = renderer.count_within(self.pose, window, task.near_obstacle_depth_m)
            # `True` is certain: if some pixels are invalid, the share of near pixels among the valid ones is larger
            if near == 0 or are_near(near, window.pixels):
                return near > 0
        return is_obstacle_near(self.depth_and_ids.cut(window).depth, task)

    @property
    def _partial(self) -> PartialRenderer | None:
        """Renderer of parts of the image; `None` if it cannot render parts, or the whole image was rendered."""
        if "frame" in self.__dict__ or "depth_and_ids" in self.__dict__:
            return None
        return as_partial(self._renderer())
