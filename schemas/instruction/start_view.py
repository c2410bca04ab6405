"""Conditions on the image at the start of an episode, which make its instruction unambiguous for the robot there.

Plan expansion sets the conditions, the worker draws starts until they hold, and validation checks them in the first
frame, all with the functions of this module. It renders nothing.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Annotated, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from schemas.base import Count, Fraction, Model, NonNegative
from schemas.config import CameraConfig
from schemas.instruction.referents import ids_in_view
from schemas.scene import MAX_INSTANCES

IN_FRONT_RAD = math.radians(30)
"""Largest angle between the heading and the direction to a target that is "in front of you", radians."""
# it is larger than `SpawnConfig.heading_noise_rad` (25 degrees by default), so near and mid starts meet it and far
# starts are restricted; the target is then in the middle 58 % of an image with a field of view of 90 degrees

Item = TypeVar("Item")
InstanceId = Annotated[int, Field(ge=1, le=MAX_INSTANCES)]
InstanceIds = Annotated[tuple[InstanceId, ...], Field(max_length=MAX_INSTANCES)]


class TargetChoice(Model):
    """Draw of the target at the start, from the objects that could be the target there; docs/language.md#plans."""

    around: InstanceId
    """Object around which the starts are drawn; the target of the planned draw."""
    among: InstanceIds
    """Objects of the category that the episode may have as its target, in the order of their ids."""
    share: Annotated[float, Field(ge=0, lt=1)]
    """Random number that selects the target: of the k objects that could be the target, in the order of their ids, the
    one at the position `floor(share * k)`, counted from 0."""

    def of(self, choices: Sequence[Item]) -> Item:
        """Returns the selected object; `choices` contains at least one object, in the order of their ids."""
        return choices[int(self.share * len(choices))]


class StartView(Model):
    """Conditions on the image and the heading at the start; docs/design/starts.md#start-view.

    In JSON, three fields have their published names: `rivals`, `alike` and `least_alike`.
    """

    model_config = ConfigDict(populate_by_name=True, serialize_by_alias=True)

    within_rad: NonNegative | None = None
    """Largest angle between the heading and the direction to the target, radians. The target must also be in view.
    `None` sets no condition."""
    other_referents: Annotated[InstanceIds, Field(alias="rivals")] = ()
    """Other objects that the instruction fits. If there are any, the target must be in view, and these objects must
    not."""
    same_category: Annotated[InstanceIds, Field(alias="alike")] = ()
    """Other objects of the target's category. None of them may be in view without the target."""
    least_same_category: Annotated[Count, Field(alias="least_alike", exclude_if=lambda it: it == 0)] = 0
    """Smallest number of objects of `same_category` that must be in view if the target is; 0 sets no condition."""
    ranks: tuple[Fraction, Fraction] | None = Field(default=None, exclude_if=lambda it: it is None)
    """Two random numbers from 0 to 1. If the first is below 1 / k, the target must be the nearest of the k objects of
    its category in view; otherwise it must not be the nearest. The second number decides in the same way about the most
    central object. `None` sets no condition."""
    choice: TargetChoice | None = Field(default=None, exclude_if=lambda it: it is None)
    """Draw of the target at the start, for which `least_same_category` counts the objects that could be the target;
    `None` if the plan names the target."""

    @property
    def shows_target(self) -> bool:
        """Whether the conditions require that the target is in view."""
        return bool(self.other_referents) or self.within_rad is not None or self.least_same_category > 0


def start_view_findings(
    view: StartView,
    target: int,
    bearing_rad: float,
    ids: NDArray[np.uint16],
    depth: NDArray[np.float32],
    camera: CameraConfig,
    min_pixels: int,
) -> list[str]:
    """Returns the conditions that a start does not meet, as sentences; empty if it meets all.

    Args:
        view: the conditions.
        target: instance id of the target.
        bearing_rad: angle from the heading to the target's centroid, radians, in [-pi, pi].
        ids: (S, S) instance ids of the image at the start.
        depth: (S, S) depth of this image, metres.
        camera: camera of the image.
        min_pixels: smallest mask of a visible object, pixels.
    """
    shown = ids_in_view(ids, min_pixels)
    findings = []
    if view.within_rad is not None and abs(bearing_rad) > view.within_rad:
        limit = math.degrees(view.within_rad)
        findings.append(
            f"the target is {math.degrees(abs(bearing_rad)):.1f} degrees from the heading, above {limit:.0f}"
        )
    if target in shown:
        others = sorted(shown.intersection(view.other_referents))
        if others:
            findings.append(f"objects {others} are in view, and the instruction fits them as well")
        same = shown.intersection(view.same_category)
        if len(same) < view.least_same_category:
            least = view.least_same_category
            findings.append(f"{len(same)} other objects of the target's category are in view, at least {least} must be")
        elif view.ranks is not None:
            findings += _rank_findings(
                view.ranks, target, same_category=same, ids=ids, depth=depth, camera=camera, min_pixels=min_pixels
            )
        return findings
    if view.shows_target:
        findings.append("the target is not in view")
    others = sorted(shown.intersection(view.same_category))
    return (
        [*findings, f"objects {others} of the target's category are in view, but not the target"]
        if others
        else findings
    )


def _rank_findings(
    ranks: tuple[float, float],
    target: int,
    same_category: frozenset[int],
    ids: NDArray[np.uint16],
    depth: NDArray[np.float32],
    camera: CameraConfig,
    min_pixels: int,
) -> list[str]:
    """Returns a sentence for each measure (distance, angle) by which the target's rank contradicts `ranks`."""
    # a start faces its target, which without this would nearly always be the most central object of its category
    seen = see_objects(ids, depth, objects={target, *same_category}, camera=camera, min_pixels=min_pixels)
    findings = []
    measures = {"nearest": _range_of, "most central": _angle_of}
    for (name, measure), share in zip(measures.items(), ranks, strict=True):
        is_first = min(seen, key=measure).id == target
        if is_first != (share * len(seen) < 1):
            findings.append(f"the target is {'' if is_first else 'not '}the {name} object of its category in view")
    return findings


def _range_of(seen: SeenObject) -> float:
    return seen.range_m


def _angle_of(seen: SeenObject) -> float:
    return abs(seen.bearing_rad)


@dataclass(frozen=True)
class SeenObject:
    """Object in view of the camera."""

    id: int
    """Value of its pixels in the id image."""
    range_m: float
    """Distance from the camera to the nearest visible point, metres."""
    bearing_rad: float
    """Horizontal angle from the optical axis to the mean column of the mask, radians; positive to the right."""
    pixels: int
    """Size of its mask, pixels."""


def see_objects(
    ids: NDArray[np.uint16],
    depth: NDArray[np.float32],
    objects: Collection[int],
    camera: CameraConfig,
    min_pixels: int,
) -> tuple[SeenObject, ...]:
    """Returns the given objects that are in view, in the order of their ids.

    Args:
        ids: (S, S) instance ids.
        depth: (S, S) metres along the optical axis, 0 where the ray hits nothing.
        objects: ids of the objects to find.
        camera: camera of the image.
        min_pixels: smallest mask of an object in view, pixels.
    """
    visible_ids = sorted(ids_in_view(ids, min_pixels).intersection(objects))
    # tangents of the angles from the optical axis to the centres of the pixels of a row or column
    half = ids.shape[0] / 2
    tangents = (np.arange(ids.shape[0]) + 0.5 - half) / half * math.tan(math.radians(camera.fov_deg) / 2)
    return tuple(_see(number, np.nonzero(ids == number), depth, tangents) for number in visible_ids)


def _see(
    number: int,
    pixels: tuple[NDArray[np.intp], ...],
    depth: NDArray[np.float32],
    tangents: NDArray[np.float64],
) -> SeenObject:
    """Returns the object with this id from the rows and columns of its pixels."""
    up, aside = tangents[pixels[0]], tangents[pixels[1]]
    ranges = depth[pixels] * np.sqrt(1 + up**2 + aside**2)
    return SeenObject(number, float(ranges.min()), math.atan(float(aside.mean())), len(ranges))
