"""What there is before an action: where the robot stands, and what its camera shows once somebody looks.

An expert's senses, and all that a policy is shown comes from here; judges nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from schemas.job import Job
from schemas.terms import EndReason
from workers.experts.sight import Sighting, is_obstacle_near, see
from workers.geometry.pose import Pose
from workers.render import DepthAndIds, RenderedFrame, Renderer

__all__ = ["LazyFrame", "Observation"]


class LazyFrame:
    """What the camera shows from one pose; drawn when somebody first looks, for most drivers never do.

    Args:
        renderer: returns what draws, with the scene loaded; may raise when it is too late to look.
        pose: of base_link.
        job: says what counts as visible and as near.
        instance_id: of the target.
    """

    def __init__(self, renderer: Callable[[], Renderer], pose: Pose, job: Job, instance_id: int) -> None:
        self._renderer, self._pose = renderer, pose
        self._job, self._instance_id = job, instance_id

    @cached_property
    def frame(self) -> RenderedFrame:
        """Colour, depth and ids."""
        return self._renderer().render(self._pose)

    @cached_property
    def relief(self) -> RenderedFrame | DepthAndIds:
        """Depth and ids, without colour where that has not been drawn already."""
        return self.frame if "frame" in self.__dict__ else self._renderer().render_depth_and_ids(self._pose)

    @cached_property
    def sighting(self) -> Sighting:
        """The target in the image."""
        return see(self.relief.ids, self.relief.depth, self._instance_id, self._job.gains.min_mask_px)

    @cached_property
    def obstacle_near(self) -> bool:
        """Whether something stands close before it."""
        return is_obstacle_near(self.relief.depth, self._job.task)


@dataclass(frozen=True)
class Observation:
    """What there is before an action; after the end, what the last action was judged on. An expert's senses."""

    camera: LazyFrame
    pose: Pose
    """Of base_link in the world frame."""
    distance_m: float
    """Planar, from base_link to the target's centroid."""
    bearing_rad: float
    """From the robot's heading to the target's centroid, counter-clockwise, in [-pi, pi]."""
    is_touching: bool
    """Whether there is a contact other than the floor."""
    end: EndReason | None = None
    """Why the episode has ended, or `None` while it goes on."""

    @property
    def frame(self) -> RenderedFrame:
        """What the camera shows."""
        return self.camera.frame

    @property
    def sighting(self) -> Sighting:
        """The target in the image."""
        return self.camera.sighting

    @property
    def obstacle_near(self) -> bool:
        """Whether something stands close before the camera."""
        return self.camera.obstacle_near
