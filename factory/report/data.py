"""What the figures are drawn from: statistics, rows, drives, frames and maps of one dataset. Values only."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from factory.stats import Statistics
from schemas.dataset import EpisodeSummary, FailedAttempt
from schemas.dataset_meta import DatasetMeta
from schemas.tokens import GRID_POINTS

__all__ = ["Drives", "FloorMap", "FrameSample", "Outlines", "ReportInput"]

Outlines = list[NDArray[np.float64]]
"""Closed loops of (K, 2) points; holes are loops too."""


@dataclass(frozen=True)
class FrameSample:
    """One frame of one episode."""

    row: EpisodeSummary
    t: int
    """Step of the frame."""
    rgb: NDArray[np.uint8]
    """(640, 640, 3) sRGB as recorded."""
    target: NDArray[np.bool_]
    """(640, 640) where the target is seen."""


@dataclass
class Drives:
    """What was read out of the episodes themselves."""

    tracks: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    """Episode id -> (K, 2) x, y of base_link in the world frame, metres, thinned."""
    tokens: NDArray[np.int64] = field(default_factory=lambda: np.zeros((GRID_POINTS, GRID_POINTS), np.int64))
    """Steps on each point of the action grid: [speed token, yaw rate token]."""
    samples: list[FrameSample] = field(default_factory=list)

    @property
    def steps(self) -> int:
        """All steps that were read."""
        return int(self.tokens.sum())


@dataclass(frozen=True)
class FloorMap:
    """The floor of a scene from above, world frame, metres."""

    bounds_m: tuple[float, float, float, float]
    """West, east, south and north end of what is not empty."""
    floor: Outlines
    """Connected floor."""
    low: Outlines
    """What stands in the robot's way."""
    wall: Outlines
    """What of that also hides what is behind."""
    surveyed_m: NDArray[np.float32]
    """(S, 2) surveyed spawn points."""
    targets_m: NDArray[np.float64]
    """(K, 2) centroids of all targets."""
    free_area_m2: float


@dataclass(frozen=True)
class ReportInput:
    """All of it."""

    meta: DatasetMeta
    statistics: Statistics
    """Its remarks hold those of reading the episodes too."""
    episodes: list[EpisodeSummary]
    failures: list[FailedAttempt] | None
    drives: Drives
    maps: dict[str, FloorMap]
    """Scene -> map; those that cannot be read are missing."""

    @property
    def scenes(self) -> list[str]:
        """Scenes of the plan, in its order."""
        return [scene.name for scene in self.meta.plan.scenes]

    def of(self, scene: str) -> list[EpisodeSummary]:
        """Returns the rows of a scene."""
        return [row for row in self.episodes if row.scene == scene]
