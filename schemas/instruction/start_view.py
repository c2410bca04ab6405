"""Conditions on the image at the start of an episode, which make its instruction clear from there.

Plan expansion sets the conditions, the worker draws starts until they hold, and validation checks them in the first
frame, all with the function of this module. It renders nothing.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from schemas.base import Model, NonNegative
from schemas.instruction.referents import ids_in_view
from schemas.scene import MAX_INSTANCES

IN_FRONT_RAD = math.radians(30)
"""Largest angle between the heading and the direction to a target that is "in front of you", radians."""

InstanceIds = Annotated[tuple[Annotated[int, Field(ge=1, le=MAX_INSTANCES)], ...], Field(max_length=MAX_INSTANCES)]


class StartView(Model):
    """Conditions on the image and the heading at the start; docs/design/starts.md#start-view."""

    within_rad: NonNegative | None = None
    """Largest angle between heading and target, which is in view; `None` sets no limit."""
    rivals: InstanceIds = ()
    """Other objects that the instruction fits. If there are any, the target is in view and none of them is."""
    alike: InstanceIds = ()
    """Other objects of the target's category. Each is in view only together with the target."""

    @property
    def shows_target(self) -> bool:
        """Whether the target is in view."""
        return bool(self.rivals) or self.within_rad is not None


def start_view_findings(
    view: StartView, target: int, bearing_rad: float, ids: NDArray[np.uint16], min_pixels: int
) -> list[str]:
    """Returns the conditions that a start does not meet, as sentences; empty if it meets all.

    Args:
        view: the conditions.
        target: instance id of the target.
        bearing_rad: angle from the heading to the target's centroid, radians, in [-pi, pi].
        ids: (H, W) instance ids of the image at the start.
        min_pixels: smallest mask of a visible object, pixels.
    """
    shown = ids_in_view(ids, min_pixels)
    found = []
    if view.within_rad is not None and abs(bearing_rad) > view.within_rad:
        limit = math.degrees(view.within_rad)
        found.append(f"the target is {math.degrees(abs(bearing_rad)):.1f} degrees from the heading, above {limit:.0f}")
    if target in shown:
        others = sorted(shown.intersection(view.rivals))
        return [*found, f"objects {others} are in view, which the instruction fits as well"] if others else found
    if view.shows_target:
        found.append("the target is not in view")
    others = sorted(shown.intersection(view.alike))
    return [*found, f"objects {others} of the target's category are in view, the target is not"] if others else found
