"""Every frame decoded once: digests, bounds, known ids, emptiness that agrees, a camera that is not frozen.

Keeps two frames in memory at a time; renders nothing and judges no motion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.bundle import BundleReader
from schemas.encoding.arrays import DEPTH_FRAME
from schemas.encoding.digest import frame_digest
from schemas.episode import EpisodeMeta
from schemas.errors import InvalidBundle
from schemas.measure import yaw_of

__all__ = ["FrameSurvey", "survey_frames"]

EMPTY_SLACK_SHARE = 0.001
"""Share of pixels that may have depth without id or id without depth: the two may be rasterised in two passes."""
FROZEN_DEPTH = (0.005, 0.005)
"""Metres and radians after which depth must differ: a float32 of any surface in view changes with far less."""
FROZEN_COLOUR = (0.15, 0.10)
"""The same for colour, which may stay the same for a while before a plain wall."""
DEPTH_SLACK_M = 1e-3
"""Depth beyond the camera's clip range: rounding of the projection."""
MAX_FINDINGS = 20
"""Findings about single frames after which the survey stops counting them out."""

_GLANCE = 64

Image = NDArray[np.generic]


@dataclass(frozen=True)
class FrameSurvey:
    """What all frames of an episode say."""

    digests: tuple[str, ...]
    """Of every frame that could be decoded."""
    target_pixels: tuple[int, ...]
    """Pixels of the target in every frame that could be decoded."""
    findings: tuple[str, ...]


def survey_frames(bundle: BundleReader, on_frame: Callable[[int], None] = lambda _t: None) -> FrameSurvey:
    """Decodes every frame and returns what they say.

    Args:
        bundle: an open bundle.
        on_frame: called with the number of each frame done.
    """
    survey = _Survey(bundle.meta, bundle.arrays.poses)
    for t in range(bundle.length):
        try:
            survey.take(t, bundle.rgb(t), bundle.depth(t), bundle.ids(t))
        except InvalidBundle as error:
            survey.note(*(f"frame {t}: {finding}" for finding in error.findings))
        on_frame(t)
    return survey.result()


class _Survey:
    def __init__(self, meta: EpisodeMeta, poses: NDArray[np.float32]) -> None:
        self._meta = meta
        self._far_m = meta.job.camera.far_m
        self._known = np.zeros(1 << 16, dtype=bool)
        self._known[[0, *(instance.id for instance in meta.instances)]] = True
        self._colour = _Stuck("rgb_front", poses, *FROZEN_COLOUR)
        self._depth = _Stuck("depth_front", poses, *FROZEN_DEPTH)
        self._digests: list[str] = []
        self._pixels: list[int] = []
        self._findings: list[str] = []
        self._suppressed = 0

    def take(self, t: int, rgb: NDArray[np.uint8], depth: NDArray[np.float32], ids: NDArray[np.uint16]) -> None:
        digest = frame_digest(rgb, depth, ids)
        self._digests.append(digest)
        recorded = self._meta.frame_digests
        if t < len(recorded) and recorded[t] != digest:
            self.note(f"frame {t}: decodes to digest {digest}, meta.json says {recorded[t]}")
        self._pixels.append(int(np.count_nonzero(ids == self._meta.target_instance_id)))
        self.note(*self._colour.take(t, rgb), *self._depth.take(t, depth))
        self.note(*(f"frame {t}: {text}" for text in self._image_findings(depth, ids)))

    def _image_findings(self, depth: NDArray[np.float32], ids: NDArray[np.uint16]) -> list[str]:
        """Looks at the extremes first: what they prove needs no second look at every pixel."""
        nearest, farthest = float(depth.min()), float(depth.max())
        found = DEPTH_FRAME.range_violations(nearest, farthest)
        if not self._known[: int(ids.max()) + 1].all():
            found += self._strange_ids(ids)
        if not (nearest > 0 and ids.min() > 0):
            found += _disagreement(depth, ids)
        if farthest > self._far_m + DEPTH_SLACK_M:
            found.append(f"depth {farthest:.3f} m is beyond the camera's range of {self._far_m:g} m")
        return found

    def _strange_ids(self, ids: NDArray[np.uint16]) -> list[str]:
        shown = _ends_of_runs(ids)
        strange = np.unique(shown[~self._known[shown]])[:5].tolist()
        return [f"seg_front shows ids {strange} that the instance table does not have"] if strange else []

    def note(self, *findings: str) -> None:
        room = MAX_FINDINGS - len(self._findings)
        self._findings += findings[:room]
        self._suppressed += len(findings[room:])

    def result(self) -> FrameSurvey:
        rest = [f"and {self._suppressed} more findings about frames"] if self._suppressed else []
        return FrameSurvey(tuple(self._digests), tuple(self._pixels), (*self._findings, *rest))


def _disagreement(depth: NDArray[np.float32], ids: NDArray[np.uint16]) -> list[str]:
    pixels = int(np.count_nonzero((depth > 0) != (ids > 0)))
    too_many = pixels > EMPTY_SLACK_SHARE * ids.size
    return [f"depth and ids disagree on what is empty in {pixels} pixels"] if too_many else []


def _ends_of_runs(ids: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Returns every id the image shows, most of them once a run of equal pixels; much cheaper than all pixels."""
    flat = ids.reshape(-1)
    return np.append(flat[np.flatnonzero(flat[1:] != flat[:-1])], flat[-1:])


class _Stuck:
    """Notices an image that stays the same while the robot moves on."""

    def __init__(self, name: str, poses: NDArray[np.float32], move_m: float, turn_rad: float) -> None:
        self._name = name
        self._move_m, self._turn_rad = move_m, turn_rad
        self._xy = poses[:, :2].astype(np.float64)
        self._yaw = yaw_of(poses)
        self._since = 0
        self._last: Image | None = None
        self._told = False

    def take(self, t: int, image: Image) -> list[str]:
        if self._last is None or not _are_same(image, self._last) or not image.any():
            self._last, self._since, self._told = image, t, False  # nothing in view looks the same from everywhere
            return []
        moved_m = float(np.hypot(*(self._xy[t] - self._xy[self._since])))
        turned = abs(float((self._yaw[t] - self._yaw[self._since] + np.pi) % (2 * np.pi) - np.pi))
        if self._told or (moved_m <= self._move_m and turned <= self._turn_rad):
            return []
        self._told = True
        moved = f"the robot moved {moved_m:.3f} m, {turned:.3f} rad"
        return [f"{self._name} is the same in frames {self._since} to {t}; {moved}"]


def _are_same(image: Image, other: Image) -> bool:
    """Compares one row in 64 first: two frames nearly always differ there."""
    return np.array_equal(image[::_GLANCE], other[::_GLANCE]) and np.array_equal(image, other)
