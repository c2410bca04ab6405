"""Observation before each action: pose of the robot, and a camera image that is rendered on the first access.

Experts and policies get their input from this module. It does not decide when an episode ends.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from schemas.job import Job
from schemas.terms import EndReason
from workers.experts.sight import Sighting, foreground_window, is_obstacle_near, see
from workers.geometry.pose import Pose
from workers.render import WHOLE, DepthAndIds, RenderedFrame, Renderer, Window, WindowRenderer


class LazyFrame:
    """Camera image from one pose, rendered on the first access, because many controllers do not use it.

    Args:
        renderer: returns the renderer with the scene loaded; raises if the episode is over.
        pose: pose of base_link.
        job: gives the thresholds for a visible target and a near obstacle.
        instance_id: id of the target.
    """

    def __init__(self, renderer: Callable[[], Renderer], pose: Pose, job: Job, instance_id: int) -> None:
        self._renderer, self._pose = renderer, pose
        self._job, self._instance_id = job, instance_id
        self._rendered: tuple[Window, DepthAndIds] | None = None
        """Last window and its part of the image."""

    @cached_property
    def frame(self) -> RenderedFrame:
        """Frame with colour, depth and ids."""
        return self._renderer().render(self._pose)

    @cached_property
    def relief(self) -> DepthAndIds:
        """Depth and ids, from the frame if it has been rendered, else rendered without colour."""
        if "frame" in self.__dict__:
            return DepthAndIds(self.frame.depth, self.frame.ids)
        return self._renderer().render_depth_and_ids(self._pose)

    @cached_property
    def sighting(self) -> Sighting:
        """Measurements of the target in the image."""
        window = self._target_window
        part = self._part(window)
        return see(part.ids, part.depth, self._instance_id, self._job.gains.min_mask_px, window.left)

    @cached_property
    def obstacle_near(self) -> bool:
        """Whether an obstacle is close in front of the camera."""
        window = foreground_window(self._job.task)
        self._part(window.joined(self._target_window))  # most controllers then look at the target
        return is_obstacle_near(self._part(window).depth, self._job.task)

    @cached_property
    def _target_window(self) -> Window:
        renderer = self._renderer()
        if isinstance(renderer, WindowRenderer):
            return renderer.window_of(self._pose, self._instance_id)
        return WHOLE

    def _part(self, window: Window) -> DepthAndIds:
        """Returns depth and ids in a window, from an image that has been rendered, else rendered without the rest."""
        if "frame" in self.__dict__ or "relief" in self.__dict__:
            return self.relief.cut(window)
        if self._rendered is None or not self._rendered[0].contains(window):
            renderer = self._renderer()
            if not isinstance(renderer, WindowRenderer):
                return self.relief.cut(window)
            self._rendered = window, renderer.render_window(self._pose, window)
        around, part = self._rendered
        return part.cut(window, around)


@dataclass(frozen=True)
class Observation:
    """State before an action, or after the end the state before the last action; implements `Senses`."""

    camera: LazyFrame
    """Camera image."""
    pose: Pose
    """Pose of base_link in the world frame."""
    distance_m: float
    """Planar distance from base_link to the target by the success measure, metres."""
    bearing_rad: float
    """Angle from the robot's heading to the target's centroid, counter-clockwise, in [-pi, pi], radians."""
    is_touching: bool
    """Whether the robot has a contact other than the floor."""
    end: EndReason | None = None
    """Reason for the end of the episode, or `None` before it."""

    @property
    def frame(self) -> RenderedFrame:
        """Frame of the camera."""
        return self.camera.frame

    @property
    def sighting(self) -> Sighting:
        """Measurements of the target in the image."""
        return self.camera.sighting

    @property
    def obstacle_near(self) -> bool:
        """Whether an obstacle is close in front of the camera."""
        return self.camera.obstacle_near
