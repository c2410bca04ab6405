"""Every frame decoded once: digests, bounds, known ids, emptiness that agrees, a camera that is not frozen.

Keeps one frame in memory at a time; renders nothing and judges no motion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xxhash
from numpy.typing import NDArray

from schemas.arrays import DEPTH_FRAME, IDS_FRAME, RGB_FRAME
from schemas.bundle import BundleReader
from schemas.digest import frame_digest
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
        specs = ((RGB_FRAME, rgb), (DEPTH_FRAME, depth), (IDS_FRAME, ids))
        self.note(*(f"frame {t}: {text}" for spec, image in specs for text in spec.violations(image)))
        digest = frame_digest(rgb, depth, ids)
        self._digests.append(digest)
        recorded = self._meta.frame_digests
        if t < len(recorded) and recorded[t] != digest:
            self.note(f"frame {t}: decodes to digest {digest}, meta.json says {recorded[t]}")
        self._pixels.append(int(np.count_nonzero(ids == self._meta.target_instance_id)))
        self.note(*self._colour.take(t, rgb), *self._depth.take(t, depth))
        self.note(*(f"frame {t}: {text}" for text in self._image_findings(depth, ids)))

    def _image_findings(self, depth: NDArray[np.float32], ids: NDArray[np.uint16]) -> list[str]:
        found = []
        shown = _ends_of_runs(ids)
        if not self._known[shown].all():
            strange = np.unique(shown[~self._known[shown]])[:5].tolist()
            found.append(f"seg_front shows ids {strange} that the instance table does not have")
        disagree = int(np.count_nonzero((depth > 0) != (ids > 0)))
        if disagree > EMPTY_SLACK_SHARE * ids.size:
            found.append(f"depth and ids disagree on what is empty in {disagree} pixels")
        if float(depth.max()) > self._far_m + DEPTH_SLACK_M:
            found.append(f"depth {float(depth.max()):.3f} m lies beyond the camera's {self._far_m:g} m")
        return found

    def note(self, *findings: str) -> None:
        room = MAX_FINDINGS - len(self._findings)
        self._findings += findings[:room]
        self._suppressed += len(findings[room:])

    def result(self) -> FrameSurvey:
        rest = [f"and {self._suppressed} more findings about frames"] if self._suppressed else []
        return FrameSurvey(tuple(self._digests), tuple(self._pixels), (*self._findings, *rest))


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
        self._last = b""
        self._told = False

    def take(self, t: int, image: Image) -> list[str]:
        digest = xxhash.xxh3_64_digest(image.data)
        if digest != self._last or not image.any():  # nothing in view looks the same from everywhere
            self._last, self._since, self._told = digest, t, False
            return []
        moved_m = float(np.hypot(*(self._xy[t] - self._xy[self._since])))
        turned = abs(float((self._yaw[t] - self._yaw[self._since] + np.pi) % (2 * np.pi) - np.pi))
        if self._told or (moved_m <= self._move_m and turned <= self._turn_rad):
            return []
        self._told = True
        moved = f"the robot moved {moved_m:.3f} m, {turned:.3f} rad"
        return [f"{self._name} is the same in frames {self._since} to {t}; {moved}"]
