"""Validates frames of a bundle: digests, value ranges, instance ids, agreement of depth and ids, frozen images.

The module decodes each validated frame once and keeps two frames in memory. It does not render and does not validate
motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.bundle import BundleReader
from schemas.encoding.arrays import DEPTH_FRAME
from schemas.encoding.digest import frame_digest
from schemas.episode import EpisodeMeta
from schemas.errors import InvalidBundle
from schemas.support.geometry import yaw_of

EMPTY_SLACK_SHARE = 0.001
"""Tolerated share of pixels with depth but no id, or an id but no depth. Two passes may rasterise differently."""
FROZEN_DEPTH = (0.005, 0.005)
"""Motion (metres, radians) after which depth must differ. Even much smaller motions change float32 depth."""
FROZEN_COLOUR = (0.15, 0.10)
"""Motion (metres, radians) after which colour must differ. In front of a plain wall, it stays equal for a while."""
DEPTH_SLACK_M = 1e-3
"""Tolerated depth beyond the camera's far plane, metres, for rounding errors of the projection."""
MAX_FINDINGS = 20
"""Maximum number of listed findings about single frames; more findings are only counted."""

_GLANCE = 64

Image = NDArray[np.generic]


@dataclass(frozen=True)
class FrameSurvey:
    """Result of the validation of frames."""

    digests: dict[int, str]
    """Digest of each decodable frame, by step."""
    target_pixels: dict[int, int]
    """Number of pixels of the target in each decodable frame, by step."""
    findings: tuple[str, ...]
    """Violations."""


def survey_frames(
    bundle: BundleReader, steps: Iterable[int], on_frame: Callable[[int], None] = lambda _t: None
) -> FrameSurvey:
    """Decodes and validates the frames of some steps.

    Args:
        bundle: open bundle.
        steps: steps in ascending order.
        on_frame: progress callback with the number of each processed frame.
    """
    survey = _Survey(bundle.meta, bundle.arrays.poses)
    for t in steps:
        try:
            survey.take(t, bundle.rgb(t), bundle.depth(t), bundle.ids(t))
        except InvalidBundle as error:
            survey.note(*(f"frame {t}: {finding}" for finding in error.findings))
        on_frame(t)
    return survey.result()


class _Survey:
    def __init__(self, meta: EpisodeMeta, poses: NDArray[np.float64]) -> None:
        self._meta = meta
        self._far_m = meta.job.camera.far_m
        self._known = np.zeros(1 << 16, dtype=bool)
        self._known[[0, *(instance.id for instance in meta.instances)]] = True
        self._colour = _FrozenImages("rgb_front", poses, *FROZEN_COLOUR)
        self._depth = _FrozenImages("depth_front", poses, *FROZEN_DEPTH)
        self._digests: dict[int, str] = {}
        self._pixels: dict[int, int] = {}
        self._findings: list[str] = []
        self._suppressed = 0

    def take(self, t: int, rgb: NDArray[np.uint8], depth: NDArray[np.float32], ids: NDArray[np.uint16]) -> None:
        digest = frame_digest(rgb, depth, ids)
        self._digests[t] = digest
        recorded = self._meta.frame_digests
        if t < len(recorded) and recorded[t] != digest:
            self.note(f"frame {t}: decodes to digest {digest}, meta.json says {recorded[t]}")
        self._pixels[t] = int(np.count_nonzero(ids == self._meta.target_instance_id))
        self.note(*self._colour.take(t, rgb), *self._depth.take(t, depth))
        self.note(*(f"frame {t}: {text}" for text in self._image_findings(depth, ids)))

    def _image_findings(self, depth: NDArray[np.float32], ids: NDArray[np.uint16]) -> list[str]:
        """Returns faults of depth and ids. Examines all pixels only if the extreme values do not rule out a fault."""
        # the extreme values suffice for nearly every frame; validation must not take longer than simulation
        nearest, farthest = float(depth.min()), float(depth.max())
        findings = DEPTH_FRAME.range_violations(nearest, farthest)
        if not self._known[: int(ids.max()) + 1].all():
            findings += self._strange_ids(ids)
        if not (nearest > 0 and ids.min() > 0):
            findings += _disagreement(depth, ids)
        if farthest > self._far_m + DEPTH_SLACK_M:
            findings.append(f"depth {farthest:.3f} m is beyond the camera's range of {self._far_m:g} m")
        return findings

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
        return FrameSurvey(self._digests, self._pixels, (*self._findings, *rest))


def _disagreement(depth: NDArray[np.float32], ids: NDArray[np.uint16]) -> list[str]:
    pixels = int(np.count_nonzero((depth > 0) != (ids > 0)))
    too_many = pixels > EMPTY_SLACK_SHARE * ids.size
    return [f"depth and ids disagree on what is empty in {pixels} pixels"] if too_many else []


def _ends_of_runs(ids: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Returns one id for each run of equal ids: every id of the image, in an array much smaller than the image."""
    flat = ids.reshape(-1)
    return np.append(flat[np.flatnonzero(flat[1:] != flat[:-1])], flat[-1:])


class _FrozenImages:
    """Detector of images that do not change while the robot moves."""

    def __init__(self, name: str, poses: NDArray[np.float64], move_m: float, turn_rad: float) -> None:
        self._name = name
        self._move_m, self._turn_rad = move_m, turn_rad
        self._xy = poses[:, :2]
        self._yaw = yaw_of(poses)
        self._since = 0
        self._last: Image | None = None
        self._told = False

    def take(self, t: int, image: Image) -> list[str]:
        if self._last is None or not _are_same(image, self._last) or not image.any():
            self._last, self._since, self._told = image, t, False  # an empty image may stay the same
            return []
        moved_m = float(np.hypot(*(self._xy[t] - self._xy[self._since])))
        turned = abs(float((self._yaw[t] - self._yaw[self._since] + np.pi) % (2 * np.pi) - np.pi))
        if self._told or (moved_m <= self._move_m and turned <= self._turn_rad):
            return []
        self._told = True
        moved = f"the robot moved {moved_m:.3f} m, {turned:.3f} rad"
        return [f"{self._name} is the same in frames {self._since} to {t}; {moved}"]


def _are_same(image: Image, other: Image) -> bool:
    """Returns whether two images are equal. Every 64th row is compared first, because most frames differ there."""
    return np.array_equal(image[::_GLANCE], other[::_GLANCE]) and np.array_equal(image, other)
