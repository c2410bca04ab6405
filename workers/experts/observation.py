"""Observation before each action: pose of the robot, and a camera image that is rendered on the first access.

Experts and policies get their input from this module. It does not decide when an episode ends.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from schemas.job import Job
from schemas.terms import EndReason
from workers.experts.image_measures import MaskMeasures, are_near, foreground_window, is_obstacle_near, measure_mask
from workers.geometry.pose import Pose
from workers.render import DepthAndIds, PartialRenderer, RenderedFrame, Renderer, as_partial


class LazyFrame:
    """Camera image from one pose, rendered on the first access, because many controllers do not use it.

    Args:
        renderer: returns the renderer with the scene loaded; raises if the episode is over.
        pose: pose of base_link.
        job: job, with the thresholds for a visible target and a near obstacle.
        instance_id: id of the target.
    """

    def __init__(self, renderer: Callable[[], Renderer], pose: Pose, job: Job, instance_id: int) -> None:
        self._renderer, self._pose = renderer, pose
        self._job, self._instance_id = job, instance_id

    @cached_property
    def frame(self) -> RenderedFrame:
        """Frame with colour, depth and ids."""
        return self._renderer().render(self._pose)

    @cached_property
    def depth_and_ids(self) -> DepthAndIds:
        """Depth and ids, from the frame if it has been rendered, else rendered without colour."""
        if "frame" in self.__dict__:
            return DepthAndIds(self.frame.depth, self.frame.ids)
        return self._renderer().render_depth_and_ids(self._pose)

    @cached_property
    def target_mask(self) -> MaskMeasures:
        """Measurements of the target in the image."""
        renderer, left = self._partial, 0
        if renderer is None:
            image = self.depth_and_ids
        else:
            (_, left, _, _), image = renderer.render_instance(self._pose, self._instance_id)
        return measure_mask(image.ids, image.depth, self._instance_id, self._job.gains.min_mask_px, left)

    @cached_property
    def obstacle_near(self) -> bool:
        """Whether an obstacle is close in front of the camera."""
        task = self._job.task
        window, renderer = foreground_window(task), self._partial
        if renderer is not None:
            near = renderer.count_within(self._pose, window, task.near_obstacle_depth_m)
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


@dataclass(frozen=True)
class Observation:
    """State before the next action; after the end, the state before the last action; implements `ExpertObservation`."""

    camera: LazyFrame
    """Camera image."""
    pose: Pose
    """Pose of base_link in the world frame."""
    distance_m: float
    """Planar distance from base_link to the target by the success measure, metres."""
    bearing_rad: float
    """Angle from the robot's heading to the target's centroid, counter-clockwise, in [-pi, pi], radians."""
    is_touching: bool
    """Whether the robot touches anything other than the floor."""
    end: EndReason | None = None
    """Reason for the end of the episode, or `None` before it."""

    @property
    def frame(self) -> RenderedFrame:
        """Frame of the camera."""
        return self.camera.frame

    @property
    def target_mask(self) -> MaskMeasures:
        """Measurements of the target in the image."""
        return self.camera.target_mask

    @property
    def obstacle_near(self) -> bool:
        """Whether an obstacle is close in front of the camera."""
        return self.camera.obstacle_near
