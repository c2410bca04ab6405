"""Models of the input of a report: statistics, rows, tracks, frames and maps of one dataset. Data only."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from factory.stats import Statistics
from factory.stats.language import EpisodeView
from factory.visualize.floor_map import FloorMap
from schemas.dataset.meta import DatasetMeta
from schemas.dataset.rows import EpisodeSummary, FailedAttempt
from schemas.plan import Plan
from schemas.terms import family_of
from schemas.tokens import GRID_POINTS


@dataclass(frozen=True)
class FrameSample:
    """Sample frame of an episode."""

    row: EpisodeSummary
    t: int
    """Step of the frame."""
    rgb: NDArray[np.uint8]
    """(640, 640, 3) recorded sRGB image."""
    target: NDArray[np.bool_]
    """(640, 640) mask of the target."""


@dataclass
class Drives:
    """Data read from the episode files: driven tracks, token counts, sample frames, objects in view."""

    tracks: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    """Episode id -> (K, 2) x, y of base_link in the world frame, metres, thinned."""
    tokens: NDArray[np.int64] = field(default_factory=lambda: np.zeros((GRID_POINTS, GRID_POINTS), np.int64))
    """Number of steps per point of the action grid: [speed token, yaw rate token]."""
    samples: list[FrameSample] = field(default_factory=list)
    views: list[EpisodeView] = field(default_factory=list)
    """Objects in view of the episodes, for the language statistics."""

    @property
    def steps(self) -> int:
        """Number of steps read."""
        return int(self.tokens.sum())


_FIRST_LAYOUTS, _LAST_LAYOUTS = 3, 2
"""The report shows maps of the first `_FIRST_LAYOUTS` and the last `_LAST_LAYOUTS` layouts of a scene family. The last
layouts are those of the unseen-scene splits."""


@dataclass(frozen=True)
class ReportInput:
    """Input of a report."""

    meta: DatasetMeta
    statistics: Statistics
    """Statistics of the dataset, with the remarks from reading the episodes."""
    episodes: list[EpisodeSummary]
    failures: list[FailedAttempt] | None
    drives: Drives
    maps: dict[str, FloorMap]
    """Scene -> map; scenes that cannot be read are missing."""

    @property
    def scenes(self) -> list[str]:
        """Scenes in the order of the plan."""
        return [scene.name for scene in self.meta.plan.scenes]

    @property
    def places(self) -> list[str]:
        """Scenes that the report shows as maps; see `mapped_scenes`."""
        return mapped_scenes(self.meta.plan)

    def of(self, scene: str) -> list[EpisodeSummary]:
        """Returns the episodes of a scene, or of all layouts of a family."""
        return [row for row in self.episodes if scene in (row.scene, family_of(row.scene))]


def mapped_scenes(plan: Plan) -> list[str]:
    """Returns the scenes of a plan that the report shows as maps; of a family, the first and the last layouts."""
    names_shown: list[str] = []
    for scene in plan.scenes:
        names = [part.name for part in plan.parts if family_of(part.name) == scene.name] if scene.layouts else []
        names_shown += [*names[:_FIRST_LAYOUTS], *names[_FIRST_LAYOUTS:][-_LAST_LAYOUTS:]] or [scene.name]
    return names_shown
